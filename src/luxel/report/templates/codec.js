// Mirrors luxel/report/codec.py: deflated, rounded cosine coefficients of log light -> linear light.
"use strict";
const Codec = (() => {
  const SIZE = 8, AREA = 64, FLOOR = 2 ** -10, CHROMA = 2, FINE_SCALE = 3;
  // A block's places from low to high frequency.
  const order = [...Array(AREA).keys()].sort((a, b) => {
    const row = (place) => place >> 3, diagonal = (place) => (place >> 3) + (place & 7);
    return diagonal(a) - diagonal(b) || row(a) - row(b);
  });
  // How much coarser each of them is rounded than the mean.
  const scale = order.map((place) => 1 + (FINE_SCALE * ((place >> 3) + (place & 7))) / (2 * (SIZE - 1)));
  // basis[frequency * 8 + place] of the orthonormal cosine transform.
  const basis = new Float32Array(AREA);
  for (let k = 0; k < SIZE; k++) for (let x = 0; x < SIZE; x++)
    basis[k * SIZE + x] = Math.sqrt((k ? 2 : 1) / SIZE) * Math.cos((Math.PI * (2 * x + 1) * k) / (2 * SIZE));

  async function inflate(text) {
    const packed = Uint8Array.from(atob(text), (letter) => letter.charCodeAt(0));
    const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
    return new Uint8Array(await new Response(stream).arrayBuffer());
  }

  // Turns one block of coefficients into values, in place; `rows` is scratch.
  function invert(block, rows) {
    rows.fill(0);
    for (let v = 0; v < SIZE; v++) for (let u = 0; u < SIZE; u++) {
      const value = block[v * SIZE + u];
      if (value !== 0) for (let x = 0; x < SIZE; x++) rows[v * SIZE + x] += value * basis[u * SIZE + x];
    }
    block.fill(0);
    for (let v = 0; v < SIZE; v++) for (let x = 0; x < SIZE; x++) {
      const value = rows[v * SIZE + x];
      if (value !== 0) for (let y = 0; y < SIZE; y++) block[y * SIZE + x] += value * basis[v * SIZE + y];
    }
  }

  function readPlane(bytes, plane, width, height, step) {
    const across = Math.ceil(width / SIZE), count = across * Math.ceil(height / SIZE);
    const high = bytes.length / 2, start = plane * AREA * count, out = new Float32Array(width * height);
    const block = new Float32Array(AREA), rows = new Float32Array(AREA);
    let mean = 0;
    for (let number = 0; number < count; number++) {
      for (let k = 0; k < AREA; k++) {
        const at = start + k * count + number, code = bytes[at] | (bytes[high + at] << 8);
        let value = (code >> 1) ^ -(code & 1);
        if (k === 0) value = mean += value;
        block[order[k]] = value * step * scale[k];
      }
      invert(block, rows);
      const left = (number % across) * SIZE, top = Math.floor(number / across) * SIZE;
      const right = Math.min(SIZE, width - left), down = Math.min(SIZE, height - top);
      for (let y = 0; y < down; y++) for (let x = 0; x < right; x++)
        out[(top + y) * width + left + x] = block[y * SIZE + x];
    }
    return out;
  }

  // Returns {width, height, light}: light is linear, three numbers a pixel, 1 is display white.
  async function decode(text, { width, height, step }) {
    const bytes = await inflate(text);
    const planes = [1, CHROMA, CHROMA].map((factor, plane) => readPlane(bytes, plane, width, height, step * factor));
    const light = new Float32Array(3 * width * height);
    const linear = (stops) => Math.max(2 ** stops - FLOOR, 0);
    for (let pixel = 0; pixel < width * height; pixel++) {
      const red = planes[1][pixel], blue = planes[2][pixel], green = planes[0][pixel] - (red + blue) / 4;
      light[3 * pixel] = linear(green + red);
      light[3 * pixel + 1] = linear(green);
      light[3 * pixel + 2] = linear(green + blue);
    }
    return { width, height, light };
  }

  return { decode };
})();
