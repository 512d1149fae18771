// The images of a frame as numbers (experiments/report/fields.py), and as canvases painted from them.

const LEVELS = 65534, NO_VALUE = 65535, REFERENCE = "";

async function inflate(base64) {
  const packed = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint16Array(await new Response(stream).arrayBuffer());  // little-endian, as every machine that has a browser
}

// Pixels as the canvas wants them, by number: a table for each mode, made when it is first needed.
class Colours {
  constructor(palette) {
    Object.assign(this, { palette, tables: {} });
  }

  table(mode) {
    return this.tables[mode] ??= mode === "error" ? this.fill(2 * LEVELS + 1, (i) => errorColour(i / LEVELS - 1, this.palette))
      : mode === "standard_error" ? this.fill(LEVELS + 1, (i) => errorColour(i / LEVELS, this.palette))
        : this.fill(LEVELS + 1, (i) => Array(3).fill(Math.round(255 * i / LEVELS)));
  }

  fill(count, colourOf) {
    const bytes = new Uint8ClampedArray(4 * count);
    for (let i = 0; i < count; i++) bytes.set([...colourOf(i), 255], 4 * i);
    return new Uint32Array(bytes.buffer);
  }
}
const NO_RECEIVER_PIXEL = new Uint32Array(new Uint8ClampedArray([...NO_RECEIVER, 255]).buffer)[0];

// One frame: numbers by label and kind, unpacked once; pictures painted when they are first looked at.
class FieldFrame {
  constructor({ frame, width, height, shaded }, colours) {
    Object.assign(this, { frame, width, height, shaded, colours, numbers: null, painted: new Map() });
  }

  async load() {
    if (this.numbers) return this;
    const numbers = {}, waits = [];
    for (const [label, kinds] of Object.entries(readJson(`fields-${this.frame}`))) {
      numbers[label] = {};
      for (const [kind, text] of Object.entries(kinds)) waits.push(inflate(text).then((field) => { numbers[label][kind] = field; }));
    }
    await Promise.all(waits);
    this.numbers = numbers;
    return this;
  }

  // NaN where there is no such image, or no receiver.
  value(label, kind, x, y) {
    const number = this.numbers?.[label]?.[kind]?.[y * this.width + x];
    return number === undefined || number === NO_VALUE ? NaN : number / LEVELS;
  }

  has(label, mode) {
    if (mode === "shaded") return Boolean(this.shadedUrl(label));
    const own = this.numbers?.[label];
    if (mode === "error") return Boolean(own && this.numbers[REFERENCE] && label !== REFERENCE);
    return Boolean(own?.[mode]);
  }

  shadedUrl(label) {
    if (this.shaded[label]) return this.shaded[label];
    const images = document.querySelectorAll(`img[data-kind="shaded"][data-frame="${this.frame}"]`);
    return [...images].find((image) => image.dataset.label === label && !image.dataset.reference)?.src;
  }

  // A canvas or image of a label in a mode, null where there is none; whenReady is called once an image has arrived.
  picture(label, mode, whenReady) {
    if (!this.has(label, mode)) return null;
    const key = `${mode} ${label}`;
    if (!this.painted.has(key)) {
      if (mode === "shaded") {
        const image = new Image();
        image.onload = whenReady;
        image.src = this.shadedUrl(label);
        this.painted.set(key, image);
      } else this.painted.set(key, this.paint(label, mode));
    }
    const found = this.painted.get(key);
    return found instanceof HTMLImageElement && !found.complete ? null : found;
  }

  paint(label, mode) {
    const canvas = el("canvas", { width: this.width, height: this.height });
    const context = canvas.getContext("2d"), image = context.createImageData(this.width, this.height);
    const own = this.numbers[label], field = own[mode === "standard_error" ? mode : "visibility"];
    const reference = mode === "error" ? this.numbers[REFERENCE].visibility : null;
    const pixels = new Uint32Array(image.data.buffer), table = this.colours.table(mode);
    for (let i = 0; i < field.length; i++) {
      if (field[i] === NO_VALUE || (reference && reference[i] === NO_VALUE)) pixels[i] = NO_RECEIVER_PIXEL;
      else pixels[i] = table[reference ? field[i] - reference[i] + LEVELS : field[i]];
    }
    context.putImageData(image, 0, 0);
    return canvas;
  }
}
