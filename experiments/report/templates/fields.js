// The images of a frame as numbers (experiments/report/fields.py), and as canvases painted from them.

const LEVELS = 65534, NO_VALUE = 65535, REFERENCE = "";

async function inflate(base64) {
  const packed = Uint8Array.from(atob(base64), (character) => character.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = new DataView(await new Response(stream).arrayBuffer());
  return Uint16Array.from({ length: bytes.byteLength / 2 }, (_, i) => bytes.getUint16(2 * i, true));
}

// One frame: numbers by label and kind, unpacked once; pictures painted when they are first looked at.
class FieldFrame {
  constructor({ frame, width, height, shaded }, palette) {
    Object.assign(this, { frame, width, height, shaded, palette, numbers: null, painted: new Map() });
  }

  async load() {
    if (this.numbers) return this;
    const packed = readJson(`fields-${this.frame}`), numbers = {};
    for (const [label, kinds] of Object.entries(packed)) {
      numbers[label] = {};
      for (const [kind, text] of Object.entries(kinds)) numbers[label][kind] = await inflate(text);
    }
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
    for (let i = 0; i < field.length; i++) {
      let colour = NO_RECEIVER;
      if (field[i] !== NO_VALUE && !(reference && reference[i] === NO_VALUE)) {
        const value = field[i] / LEVELS;
        colour = mode === "visibility" ? Array(3).fill(Math.round(255 * value))
          : errorColour(reference ? value - reference[i] / LEVELS : value, this.palette);
      }
      image.data.set(colour, 4 * i);
      image.data[4 * i + 3] = 255;
    }
    context.putImageData(image, 0, 0);
    return canvas;
  }
}
