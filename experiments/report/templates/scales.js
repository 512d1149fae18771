// Axes: where values lie, and which ticks are written.

// A scale from values to [from, to] (pixels). Positive values lie on a logarithmic axis; exact zeros, which techniques
// that equal the reference have, in a strip of their own at its low end; negative values make the axis linear.
function makeScale(values, from, to) {
  const known = values.filter((value) => Number.isFinite(value));
  if (known.some((value) => value < 0) || !known.some((value) => value > 0)) return linearScale(known, from, to);
  return logScale(known, from, to);
}

function logScale(values, from, to) {
  const positive = values.filter((value) => value > 0);
  const zeros = positive.length < values.length;
  let low = Math.min(...positive), high = Math.max(...positive);
  const room = Math.max((high / low) ** 0.06, 1.15);
  low /= room;
  high *= room;
  const strip = zeros ? Math.sign(to - from) * 34 : 0;
  const start = from + strip, slope = (to - start) / Math.log(high / low);
  const position = (value) => value > 0 ? start + slope * Math.log(Math.max(value, low) / low) : from + 0.4 * strip;
  const ticks = zeros ? [{ value: 0, text: "0" }] : [];
  const decades = Math.log10(high / low);
  if (decades < 0.5) return { kind: "log", position, ticks: [...ticks, ...linearTicks(low, high, 5)], low, high, zero: zeros ? start : null };
  const named = decades < 1.3 ? [1, 2, 3, 5, 7] : decades < 2.6 ? [1, 2, 5] : [1];
  for (let power = Math.floor(Math.log10(low)); power <= Math.ceil(Math.log10(high)); power++) {
    for (let digit = 1; digit < 10; digit++) {
      const value = digit * 10 ** power;
      if (value < low || value > high) continue;
      ticks.push({ value, text: named.includes(digit) ? tickText(value) : "" });
    }
  }
  return { kind: "log", position, ticks, low, high, zero: zeros ? start : null };
}

function linearScale(values, from, to) {
  let low = Math.min(...values), high = Math.max(...values);
  if (!values.length) [low, high] = [0, 1];
  if (low === high) [low, high] = low === 0 ? [0, 1] : [low - 0.5 * Math.abs(low), high + 0.5 * Math.abs(low)];
  const room = 0.06 * (high - low);
  if (low !== 0) low -= room;
  high += room;
  const position = (value) => from + (to - from) * (value - low) / (high - low);
  return { kind: "linear", position, ticks: linearTicks(low, high), low, high, zero: null };
}

function linearTicks(low, high, wanted = 6) {
  const raw = (high - low) / wanted, power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((digit) => digit * power).find((size) => size >= raw);
  const ticks = [];
  for (let i = Math.ceil(low / step); i * step <= high; i++) ticks.push({ value: i * step, text: tickText(i * step) });
  return ticks;
}

function tickText(value) {
  const rounded = Number(value.toPrecision(4));
  const size = Math.abs(rounded);
  return (size !== 0 && (size < 1e-4 || size >= 1e5) ? rounded.toExponential() : String(rounded)).replace("-", "−");
}

// Grid lines, tick texts and the title of both axes of a plot of a width and height with margins around it.
function drawAxes(x, y, box, titles) {
  const group = svg("g", { class: "axes", "aria-hidden": "true" });
  const spaced = (ticks, scale, gap) => {
    let last = -Infinity;
    return ticks.map((tick) => {
      const at = scale.position(tick.value);
      const text = tick.text && Math.abs(at - last) >= gap ? tick.text : "";
      if (text) last = at;
      return { at, text, named: tick.text };
    });
  };
  for (const tick of spaced(x.ticks, x, 38)) {
    group.append(svg("line", { class: tick.named ? "grid" : "grid minor", x1: tick.at, x2: tick.at, y1: box.top, y2: box.bottom }));
    if (tick.text) group.append(svg("text", { class: "tick", x: tick.at, y: box.bottom + 16, "text-anchor": "middle" }, tick.text));
  }
  for (const tick of spaced(y.ticks, y, 15)) {
    group.append(svg("line", { class: tick.named ? "grid" : "grid minor", x1: box.left, x2: box.right, y1: tick.at, y2: tick.at }));
    if (tick.text) group.append(svg("text", { class: "tick", x: box.left - 7, y: tick.at + 4, "text-anchor": "end" }, tick.text));
  }
  group.append(svg("path", { class: "frame", d: `M${box.left},${box.top}V${box.bottom}H${box.right}` }));
  if (titles.x) group.append(svg("text", { class: "title", x: box.right, y: box.bottom + 36, "text-anchor": "end" }, titles.x));
  if (titles.y) group.append(svg("text", { class: "title", x: 2, y: box.top - 10 }, titles.y));
  return group;
}

function axisTitle(column) {
  return column.unit ? `${column.title} [${column.unit}]` : column.title;
}
