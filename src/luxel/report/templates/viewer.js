// Two pictures with a movable split, their difference, their FLIP maps; exposure and zoom. One viewer a scene.
"use strict";
(() => {
  const KEPT = 10, LEVELS = 1 << 14, NEUTRAL = [22, 23, 26];
  // Percent of display white at which the difference map is saturated.
  const RANGES = [100, 50, 25, 10, 5, 2, 1];
  const data = JSON.parse(document.getElementById("viewers").textContent);

  // ---------- Light to screen ----------
  const curve = new Float32Array(LEVELS);
  for (let level = 0; level < LEVELS; level++) {
    const light = level / (LEVELS - 1);
    curve[level] = light <= 0.0031308 ? 12.92 * light : 1.055 * light ** (1 / 2.4) - 0.055;
  }
  const display = (light) => curve[light >= 1 ? LEVELS - 1 : (light * (LEVELS - 1) + 0.5) | 0];

  // Blue where left is darker, amber where it is brighter; both ends run to white, so that strength reads in print too.
  const ramps = [[[38, 116, 214], [190, 226, 255]], [[226, 112, 20], [255, 232, 178]]];
  function tint(share) {
    const size = Math.min(Math.abs(share), 1), ramp = ramps[share < 0 ? 0 : 1];
    const [from, to, t] = size < 0.6 ? [NEUTRAL, ramp[0], size / 0.6] : [ramp[0], ramp[1], (size - 0.6) / 0.4];
    return from.map((value, channel) => value + (to[channel] - value) * t);
  }
  const tints = Array.from({ length: 513 }, (_, place) => tint(place / 256 - 1));

  function paint({ width, height }, fill) {
    const canvas = Object.assign(document.createElement("canvas"), { width, height });
    const context = canvas.getContext("2d"), image = context.createImageData(width, height);
    fill(image.data);
    context.putImageData(image, 0, 0);
    return canvas;
  }
  const expose = (picture, factor) => paint(picture, (out) => {
    const { light } = picture;
    for (let pixel = 0, at = 0; at < light.length; pixel += 4, at += 3) {
      for (let channel = 0; channel < 3; channel++) out[pixel + channel] = 255 * display(light[at + channel] * factor) + 0.5;
      out[pixel + 3] = 255;
    }
  });
  const subtract = (left, right, factor, range) => paint(left, (out) => {
    const a = left.light, b = right.light;
    for (let pixel = 0, at = 0; at < a.length; pixel += 4, at += 3) {
      let difference = 0;
      for (let c = at; c < at + 3; c++) difference += display(a[c] * factor) - display(b[c] * factor);
      const share = Math.max(-1, Math.min(1, difference / 3 / range)), colour = tints[Math.round(256 * share) + 256];
      out[pixel] = colour[0]; out[pixel + 1] = colour[1]; out[pixel + 2] = colour[2]; out[pixel + 3] = 255;
    }
  });

  // ---------- Pictures, decoded when first looked at; the last few are kept ----------
  const decoded = new Map();
  function load(about) {
    const found = decoded.get(about.id) ?? Codec.decode(document.getElementById(about.id).textContent, about);
    decoded.delete(about.id);
    decoded.set(about.id, found);
    if (decoded.size > KEPT) decoded.delete(decoded.keys().next().value);
    return found;
  }
  async function loadMap(address) {
    if (!address) return null;
    const image = new Image();
    image.src = address;
    await image.decode();
    return image;
  }

  // ---------- One viewer ----------
  class Viewer {
    constructor(root) {
      this.root = root;
      this.scene = data[Number(root.dataset.viewer)];
      const names = this.scene.entries.map((entry) => entry.label);
      this.left = Math.max(0, names.indexOf(this.scene.first));
      this.right = this.left === 0 ? 1 : 0;
      Object.assign(this, { layer: "image", mode: "split", exposure: 0, gain: 3, split: 0.5, zoom: null, job: 0 });
      this.find = (selector) => root.querySelector(selector);
      this.stage = this.find(".stage");
      this.canvas = this.find("canvas");
      this.handle = this.find(".split");
      const first = Object.values(this.scene.entries[0].pictures)[0];
      this.size = { width: first.width, height: first.height };
      this.center = { x: first.width / 2, y: first.height / 2 };
      this.stage.style.setProperty("--ratio", first.width / first.height);
      this.listen();
      this.write([this.scene.entries[this.left], this.scene.entries[this.right]]);
      new ResizeObserver(() => this.draw()).observe(this.stage);
    }

    start() {
      if (!this.started) this.refresh();
      this.started = true;
    }

    // Gets and paints what the choices ask for; a newer call makes an older one give up.
    async refresh() {
      const job = ++this.job, sides = [this.left, this.right].map((number) => this.scene.entries[number]);
      this.write(sides);
      this.root.setAttribute("aria-busy", true);
      const wait = setTimeout(() => this.find(".wait").classList.add("on"), 120);
      const factor = 2 ** this.exposure;
      const abouts = sides.map((entry) => entry.pictures[this.layer]);
      const pictures = await Promise.all(abouts.map((about) => (about ? load(about) : null)));
      let painted;
      if (this.mode === "flip") painted = await Promise.all(sides.map((entry) => loadMap(entry.flip)));
      else if (job !== this.job) return;
      else if (this.mode === "split") painted = pictures.map((picture) => picture && expose(picture, factor));
      else painted = [pictures[0] && pictures[1] && subtract(...pictures, factor, RANGES[this.gain] / 100), null];
      if (job === this.job) {
        Object.assign(this, { pictures, painted });
        clearTimeout(wait);
        this.find(".wait").classList.remove("on");
        this.draw();
        this.root.setAttribute("aria-busy", false);
      } else clearTimeout(wait);
    }

    // ---------- Drawing ----------
    measure() {
      const { clientWidth: wide, clientHeight: high } = this.stage;
      const fit = Math.min(wide / this.size.width, high / this.size.height);
      const scale = this.zoom ?? fit;
      const clamp = (value, shown, whole) =>
        shown >= whole ? whole / 2 : Math.max(shown / 2, Math.min(whole - shown / 2, value));
      this.center.x = clamp(this.center.x, wide / scale, this.size.width);
      this.center.y = clamp(this.center.y, high / scale, this.size.height);
      return { wide, high, fit, scale, x: wide / 2 - this.center.x * scale, y: high / 2 - this.center.y * scale };
    }

    draw() {
      if (!this.painted) return;
      const { wide, high, scale, x, y } = this.measure(), ratio = devicePixelRatio || 1;
      const { canvas } = this, context = canvas.getContext("2d");
      canvas.width = Math.round(wide * ratio);
      canvas.height = Math.round(high * ratio);
      context.setTransform(ratio, 0, 0, ratio, 0, 0);
      context.imageSmoothingEnabled = scale * ratio < 2;
      context.imageSmoothingQuality = "high";
      const edge = this.mode === "difference" ? wide : this.split * wide;
      const part = (picture, from, to) => {
        if (!picture || to <= from) return;
        context.save();
        context.beginPath();
        context.rect(from, 0, to - from, high);
        context.clip();
        context.drawImage(picture, x, y, this.size.width * scale, this.size.height * scale);
        context.restore();
      };
      part(this.painted[0], 0, edge);
      part(this.painted[1], edge, wide);
      this.handle.style.left = `${100 * this.split}%`;
      this.handle.setAttribute("aria-valuenow", Math.round(100 * this.split));
      this.find(".zoom output").textContent = this.zoom === null ? "fit" : `${Math.round(100 * scale)} %`;
    }

    // ---------- Words beside the pictures ----------
    write([left, right]) {
      const { mode } = this;
      this.root.dataset.mode = mode;
      const tag = (side, entry, text) => {
        const place = this.find(`.tag.${side}`);
        place.textContent = text;
        place.style.setProperty("--c", `var(--c-${entry.colour})`);
      };
      const gone = (entry) => (entry.pictures[this.layer] || mode === "flip" ? "" : ": no such picture");
      const map = (entry) => (mode !== "flip" ? "" : entry.flip ? " against the truth" : ": no FLIP map");
      tag("left", left, mode === "difference" ? `${left.label} − ${right.label}` : left.label + gone(left) + map(left));
      tag("right", right, mode === "difference" ? "" : right.label + gone(right) + map(right));
      const stops = this.exposure;
      this.find('[data-for="exposure"] output').textContent =
        `${stops > 0 ? "+" : stops < 0 ? "−" : ""}${Math.abs(stops)} stops`;
      this.find('[data-for="exposure"]').hidden = mode === "flip";
      this.find('[data-for="gain"]').hidden = mode !== "difference";
      const range = `${RANGES[this.gain]} %`;
      this.find('[data-for="gain"] output').textContent = `± ${range}`;
      this.find(".legend").hidden = mode === "split";
      this.find(".legend .low").textContent = mode === "flip" ? "0 same" : `−${range} darker`;
      this.find(".legend .high").textContent = mode === "flip" ? "1 different" : `brighter +${range}`;
      for (const side of ["left", "right"]) this.find(`[data-side=${side}]`).value = this[side];
      for (const button of this.root.querySelectorAll("[data-pick]")) {
        const number = Number(button.dataset.pick);
        button.dataset.at = number === this.left ? "left" : number === this.right ? "right" : "";
        button.setAttribute("aria-pressed", button.dataset.at !== "");
      }
      const rows = [["regional", "Error"], ["bias", "Bias"], ["flip", "FLIP"], ["frame_ms", "Frame"], ["run", "Run"]];
      this.find(".duo tbody").replaceChildren(...rows.map(([name, title]) => {
        const row = document.createElement("tr");
        for (const text of [left.figures[name] ?? "–", title, right.figures[name] ?? "–"])
          row.append(Object.assign(document.createElement("td"), { textContent: text }));
        return row;
      }));
    }

    // Writes the light of the pixel under the pointer, as radiance: the exposure is only the display's.
    probe(event) {
      const box = this.stage.getBoundingClientRect(), { x, y, scale } = this.measure();
      const column = Math.floor((event.clientX - box.left - x) / scale);
      const row = Math.floor((event.clientY - box.top - y) / scale);
      const { width, height } = this.size, place = this.find(".probe");
      if (!this.pictures || column < 0 || row < 0 || column >= width || row >= height) return;
      const digits = (value) => (value < 1e-6 ? "0" : value >= 100 ? value.toFixed(0) : value.toPrecision(3)).padEnd(8);
      const light = (picture) => {
        const at = 3 * (row * width + column);
        return picture ? [0, 1, 2].map((c) => digits(picture.light[at + c] / this.scene.exposure)).join(" ") : "–";
      };
      place.textContent = `pixel ${column}, ${row}: radiance r g b\n`
        + `left   ${light(this.pictures[0])}\nright  ${light(this.pictures[1])}`;
    }

    // ---------- Input ----------
    setSplit(share) {
      this.split = Math.max(0, Math.min(1, share));
      this.draw();
    }

    zoomBy(factor, from) {
      const { fit, scale, x, y, wide, high } = this.measure();
      const next = Math.min(32, scale * factor), [px, py] = from ?? [wide / 2, high / 2];
      this.zoom = next <= fit * 1.001 ? null : next;
      // What lies under the pointer stays there.
      this.center = { x: (px - x) / scale + (wide / 2 - px) / next, y: (py - y) / scale + (high / 2 - py) / next };
      this.draw();
    }

    drag(event) {
      if (event.button > 0) return;
      const box = this.stage.getBoundingClientRect(), splits = this.mode !== "difference";
      const near = Math.abs(event.clientX - box.left - this.split * box.width) < 16 || event.target.closest(".split");
      const moves = this.zoom !== null && !(splits && near);
      if (!moves && !splits) return;
      let last = [event.clientX, event.clientY];
      const follow = (next) => {
        if (!moves) return this.setSplit((next.clientX - box.left) / box.width);
        const { scale } = this.measure();
        this.center.x -= (next.clientX - last[0]) / scale;
        this.center.y -= (next.clientY - last[1]) / scale;
        last = [next.clientX, next.clientY];
        this.draw();
      };
      if (!moves) this.handle.focus({ preventScroll: true });
      follow(event);
      event.preventDefault();
      this.stage.setPointerCapture(event.pointerId);
      const stop = () => this.stage.removeEventListener("pointermove", follow);
      this.stage.addEventListener("pointermove", follow);
      for (const end of ["pointerup", "pointercancel"]) this.stage.addEventListener(end, stop, { once: true });
    }

    listen() {
      const on = (selector, type, act) => {
        for (const one of this.root.querySelectorAll(selector)) one.addEventListener(type, (event) => act(one, event));
      };
      const choose = (change) => { Object.assign(this, change); this.refresh(); };
      on("select", "change", (one) => choose({ [one.dataset.side]: Number(one.value) }));
      on("[data-pick]", "click", (one, event) =>
        choose({ [event.shiftKey ? "right" : "left"]: Number(one.dataset.pick) }));
      on('[name^="layer"]', "change", (one) => choose({ layer: one.value }));
      on('[name^="mode"]', "change", (one) => choose({ mode: one.value }));
      on("[data-set]", "input", (one) => choose({ [one.dataset.set]: Number(one.value) }));
      on("[data-set]", "dblclick", (one) => { one.value = one.defaultValue; choose({ [one.dataset.set]: Number(one.value) }); });
      const acts = {
        swap: () => choose({ left: this.right, right: this.left }),
        in: () => this.zoomBy(1.5),
        out: () => this.zoomBy(1 / 1.5),
        one: () => { this.zoom = 1; this.draw(); },
        fit: () => { this.zoom = null; this.draw(); },
      };
      on("[data-do]", "click", (one) => acts[one.dataset.do]());
      const keys = { ArrowLeft: -0.01, ArrowRight: 0.01, ArrowDown: -0.01, ArrowUp: 0.01, PageDown: -0.1, PageUp: 0.1 };
      this.handle.addEventListener("keydown", (event) => {
        const step = (keys[event.key] ?? 0) * (event.shiftKey ? 10 : 1);
        if (step) this.setSplit(this.split + step);
        else if (event.key === "Home" || event.key === "End") this.setSplit(event.key === "End" ? 1 : 0);
        else return;
        event.preventDefault();
      });
      this.stage.addEventListener("pointerdown", (event) => this.drag(event));
      this.stage.addEventListener("pointermove", (event) => this.probe(event));
      this.stage.addEventListener("dblclick", (event) => {
        const box = this.stage.getBoundingClientRect(), { fit } = this.measure();
        if (this.zoom === null) this.zoomBy(4 / fit, [event.clientX - box.left, event.clientY - box.top]);
        else acts.fit();
      });
      // Without a key the wheel scrolls the page, as everywhere.
      this.stage.addEventListener("wheel", (event) => {
        if (!event.ctrlKey && !event.metaKey) return;
        const box = this.stage.getBoundingClientRect();
        event.preventDefault();
        this.zoomBy(2 ** (-event.deltaY / 200), [event.clientX - box.left, event.clientY - box.top]);
      }, { passive: false });
    }
  }

  // Scenes further down decode when they come near the window, or when the page is printed.
  const viewers = new Map([...document.querySelectorAll(".viewer")].map((root) => [root, new Viewer(root)]));
  const near = new IntersectionObserver((entries) => {
    for (const entry of entries) if (entry.isIntersecting) viewers.get(entry.target).start();
  }, { rootMargin: "300px" });
  for (const root of viewers.keys()) near.observe(root);
  addEventListener("beforeprint", () => { for (const viewer of viewers.values()) viewer.start(); });
})();
