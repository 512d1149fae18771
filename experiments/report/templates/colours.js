// From numbers to colours: the scales of the folder's PNG files, and their legends.

const NO_RECEIVER = [74, 80, 96];

// Red, green, blue of a signed error, on sign(error) x sqrt|error|; palette: 3 bytes for each step from -1 to 1.
function errorColour(error, palette) {
  const half = (palette.length / 3 - 1) / 2;
  const place = 3 * Math.round(half + half * Math.sign(error) * Math.sqrt(Math.min(1, Math.abs(error))));
  return [palette[place], palette[place + 1], palette[place + 2]];
}

function bytesOfHex(text) {
  return Uint8Array.from({ length: text.length / 2 }, (_, i) => parseInt(text.slice(2 * i, 2 * i + 2), 16));
}

// A bar with ticks: [[value, text]...] at place(value) in [0, 1], colours from colourAt(0..1).
function colourBar(title, colourAt, ticks) {
  const stops = Array.from({ length: 65 }, (_, i) => `rgb(${colourAt(i / 64).join(" ")}) ${(i / 0.64).toFixed(1)}%`);
  return el("figure", { class: "colour-bar" }, el("figcaption", {}, title),
    el("div", { class: "bar", style: `background: linear-gradient(to right, ${stops.join(", ")})` }),
    el("div", { class: "ticks", "aria-hidden": "true" }, ticks.map(([place, text]) => el("span", { style: `left: ${100 * place}%` }, text))));
}

function barOf(mode, palette) {
  const signedPlace = (value) => 0.5 + 0.5 * Math.sign(value) * Math.sqrt(Math.abs(value));
  if (mode === "visibility") {
    const grey = (t) => Array(3).fill(Math.round(255 * t));
    return colourBar("visibility: 0 umbra, 1 lit", grey, [0, 0.25, 0.5, 0.75, 1].map((value) => [value, String(value)]));
  }
  if (mode === "error") {
    const at = (t) => errorColour(Math.sign(2 * t - 1) * (2 * t - 1) ** 2, palette);
    return colourBar("visibility minus reference: blue is too dark, red too light; colour goes with the root of the error", at,
      [-1, -0.5, -0.25, -0.1, -0.02, 0, 0.02, 0.1, 0.25, 0.5, 1].map((value) => [signedPlace(value), value ? signed(value, 2).replace(/0+$/, "").replace(/\.$/, "") : "0"]));
  }
  if (mode === "standard_error") {
    const at = (t) => errorColour(t * t, palette);
    return colourBar("the technique's own standard error; colour goes with its root", at,
      [0, 0.01, 0.05, 0.1, 0.25, 0.5, 1].map((value) => [Math.sqrt(value), String(value)]));
  }
  return null;
}
