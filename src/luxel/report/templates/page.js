// Tables that sort, tips, the copy button, and what printing needs.
"use strict";
(() => {
  // ---------- Tables ----------
  function sortBy(table, column) {
    const head = table.tHead.rows[0].cells[column], body = table.tBodies[0];
    const upward = head.getAttribute("aria-sort") !== "ascending";
    for (const cell of table.tHead.rows[0].cells) cell.setAttribute("aria-sort", "none");
    head.setAttribute("aria-sort", upward ? "ascending" : "descending");
    const key = (row) => row.cells[column].dataset.key;
    const rows = [...body.rows].sort((first, second) => {
      const a = key(first), b = key(second);
      // What has no figure stays at the end, whichever way the rest goes.
      if (a === "" || b === "") return (a === "") - (b === "");
      const order = column === 0 ? a.localeCompare(b) : Number(a) - Number(b);
      return upward ? order : -order;
    });
    body.append(...rows);
  }
  for (const table of document.querySelectorAll("table.sortable"))
    [...table.tHead.rows[0].cells].forEach((cell, column) =>
      cell.querySelector("button").addEventListener("click", () => sortBy(table, column)));

  // ---------- Tips ----------
  const tip = document.getElementById("tip");
  function showTip(element, left, top) {
    const target = element.closest?.("[data-tip]");
    tip.hidden = !target;
    if (!target) return;
    tip.textContent = target.dataset.tip;
    const { width, height } = tip.getBoundingClientRect();
    const x = Math.min(left + 14, innerWidth - width - 8);
    const y = top + 18 + height > innerHeight ? top - height - 10 : top + 18;
    tip.style.transform = `translate(${Math.max(8, x)}px, ${y}px)`;
  }
  document.addEventListener("pointermove", (event) => showTip(event.target, event.clientX, event.clientY), { passive: true });
  function showFocused() {
    const target = document.activeElement;
    if (!target.matches(":focus-visible")) { tip.hidden = true; return; }
    const { left, bottom } = target.getBoundingClientRect();
    showTip(target, left, bottom - 10);
  }
  document.addEventListener("focusin", showFocused);
  document.addEventListener("pointerleave", () => { tip.hidden = true; });
  document.addEventListener("scroll", showFocused, { passive: true });

  // Pointing at one curve dims the others of its plot.
  for (const plot of document.querySelectorAll("svg.plot")) {
    plot.addEventListener("pointerover", (event) => {
      const line = event.target.closest("[data-line]");
      plot.classList.toggle("focus", Boolean(line));
      for (const one of plot.querySelectorAll("[data-line]"))
        one.classList.toggle("on", Boolean(line) && one.dataset.line === line.dataset.line);
    });
    plot.addEventListener("pointerleave", () => plot.classList.remove("focus"));
  }

  // ---------- Copying ----------
  async function copy(text) {
    try {
      await navigator.clipboard.writeText(text);
    } catch {
      // A page from disk may have no clipboard: the old way still works.
      const field = Object.assign(document.createElement("textarea"), { value: text });
      document.body.append(field);
      field.select();
      document.execCommand("copy");
      field.remove();
    }
  }
  for (const button of document.querySelectorAll("[data-copy]"))
    button.addEventListener("click", async () => {
      await copy(document.getElementById(button.dataset.copy).textContent);
      button.textContent = "Copied";
      setTimeout(() => { button.textContent = "Copy"; }, 1500);
    });

  // ---------- Printing: what is folded away on screen stands on paper ----------
  let opened = [];
  addEventListener("beforeprint", () => {
    opened = [...document.querySelectorAll("details:not([open])")];
    for (const one of opened) one.open = true;
  });
  addEventListener("afterprint", () => { for (const one of opened) one.open = false; });

  // ---------- Which section is being read ----------
  const links = new Map([...document.querySelectorAll("nav a")].map((link) => [link.hash.slice(1), link]));
  const seen = new IntersectionObserver((entries) => {
    for (const entry of entries)
      if (entry.isIntersecting) for (const [id, link] of links) link.classList.toggle("here", id === entry.target.id);
  }, { rootMargin: "-20% 0px -75% 0px" });
  for (const id of links.keys()) seen.observe(document.getElementById(id));
})();
