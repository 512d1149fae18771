// What every part uses: elements, numbers, the page's data, and which groups are shown.

const SVG = "http://www.w3.org/2000/svg";

// An element with attributes and children; false and null attributes and children are left out.
function el(tag, attributes = {}, ...children) {
  return furnish(document.createElement(tag), attributes, children);
}

function svg(tag, attributes = {}, ...children) {
  return furnish(document.createElementNS(SVG, tag), attributes, children);
}

function furnish(node, attributes, children) {
  for (const [name, value] of Object.entries(attributes)) {
    if (value === false || value === null || value === undefined) continue;
    if (name.startsWith("on")) node.addEventListener(name.slice(2), value);
    else node.setAttribute(name, value === true ? "" : value);
  }
  node.append(...children.flat().filter((child) => child !== null && child !== undefined && child !== false));
  return node;
}

function readJson(id) {
  const holder = document.getElementById(id);
  return holder ? JSON.parse(holder.textContent) : null;
}

// Three significant digits, as in the page's tables.
function number(value, digits = 3) {
  if (value === null || value === undefined || !Number.isFinite(value)) return "";
  if (value === 0) return "0";
  const size = Math.abs(value);
  if (size < 1e-4 || size >= 1e6) return value.toExponential(digits - 1).replace("-", "−");
  const decimals = Math.max(0, digits - 1 - Math.floor(Math.log10(size)));
  return value.toFixed(decimals).replace("-", "−");
}

function signed(value, decimals) {
  return (value > 0 ? "+" : value < 0 ? "−" : "±") + Math.abs(value).toFixed(decimals);
}

function clamp(value, low, high) {
  return Math.min(high, Math.max(low, value));
}

// Looks follow from the place in the list of groups, labels or techniques: of labels they are those in plots/.
const MARKERS = {
  o: "M6,0A6,6 0 1 1 -6,0A6,6 0 1 1 6,0Z",
  s: "M-5.4,-5.4H5.4V5.4H-5.4Z",
  D: "M0,-7.4L7.4,0L0,7.4L-7.4,0Z",
  "^": "M0,-7L6.8,5.4H-6.8Z",
  v: "M0,7L6.8,-5.4H-6.8Z",
  P: "M-2.4,-6.8H2.4V-2.4H6.8V2.4H2.4V6.8H-2.4V2.4H-6.8V-2.4H-2.4Z",
  X: "M-6.4,-3L-3,-6.4L0,-3.4L3,-6.4L6.4,-3L3.4,0L6.4,3L3,6.4L0,3.4L-3,6.4L-6.4,3L-3.4,0Z",
  "<": "M-7,0L5.4,-6.8V6.8Z",
  ">": "M7,0L-5.4,-6.8V6.8Z",
  h: "M0,-7L6.1,-3.5V3.5L0,7L-6.1,3.5V-3.5Z",
  "*": "M0,-8L2.1,-2.6L7.6,-2.5L3.2,1L4.7,6.5L0,3.3L-4.7,6.5L-3.2,1L-7.6,-2.5L-2.1,-2.6Z",
};
const MARKER_ORDER = Object.keys(MARKERS);
const COLOR_COUNT = 10;
const DASHES = ["", "7 3", "2 2.5", "9 3 2 3"];

function colorOf(index) {
  return `var(--c${index % COLOR_COUNT})`;
}

function markerOf(index) {
  return MARKERS[MARKER_ORDER[index % MARKER_ORDER.length]];
}

// Which groups of points are hidden, for all charts of the page at once.
const shown = {
  hidden: new Set(),
  watchers: [],
  watch(callback) { this.watchers.push(callback); },
  set(names) {
    this.hidden = new Set(names);
    for (const callback of this.watchers) callback();
  },
  toggle(name) {
    const names = new Set(this.hidden);
    if (!names.delete(name)) names.add(name);
    this.set(names);
  },
};

// Calls draw(width) now and whenever the element's width changes.
function onWidth(node, draw) {
  let last = 0;
  const update = () => {
    const width = Math.floor(node.clientWidth);
    if (width > 0 && width !== last) draw(last = width);
  };
  new ResizeObserver(update).observe(node);
  update();
}
