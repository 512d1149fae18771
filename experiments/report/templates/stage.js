// Which part of the image is seen, and its drawing: one spot and zoom for everything that shows it.

const MOST_ZOOM = 64;  // window pixels for an image pixel; small images can be brought 8 times as near as they fit
const NUMBERS_FROM = 38;  // zoom from which pixels have their values written on them

class Spot {
  constructor(width, height) {
    Object.assign(this, { width, height, x: width / 2, y: height / 2, zoom: 1, fit: 1 });
  }

  // The zoom at which the whole image fits a window; a window that was fitted stays so.
  setWindow(width, height) {
    const fitted = this.zoom <= this.fit * 1.001;
    Object.assign(this, { windowWidth: width, windowHeight: height, fit: Math.min(width / this.width, height / this.height) });
    if (fitted) this.zoom = this.fit;
    this.settle();
  }

  nearest(zoom) {
    return clamp(zoom, this.fit, Math.max(MOST_ZOOM, 8 * this.fit));
  }

  settle() {
    this.zoom = this.nearest(this.zoom);
    const spareX = Math.min(this.width, this.windowWidth / this.zoom) / 2, spareY = Math.min(this.height, this.windowHeight / this.zoom) / 2;
    this.x = clamp(this.x, spareX, this.width - spareX);
    this.y = clamp(this.y, spareY, this.height - spareY);
  }

  // Window position -> image position, both with fractions.
  imageAt(px, py) {
    return [this.x + (px - this.windowWidth / 2) / this.zoom, this.y + (py - this.windowHeight / 2) / this.zoom];
  }

  windowAt(x, y) {
    return [(x - this.x) * this.zoom + this.windowWidth / 2, (y - this.y) * this.zoom + this.windowHeight / 2];
  }

  // What lies under a window position stays there.
  zoomBy(factor, px = this.windowWidth / 2, py = this.windowHeight / 2) {
    const [x, y] = this.imageAt(px, py);
    this.zoom = this.nearest(this.zoom * factor);
    this.x = x - (px - this.windowWidth / 2) / this.zoom;
    this.y = y - (py - this.windowHeight / 2) / this.zoom;
    this.settle();
  }

  panBy(dx, dy) {
    this.x -= dx / this.zoom;
    this.y -= dy / this.zoom;
    this.settle();
  }

  reset() {
    this.zoom = this.fit;
    this.settle();
  }
}

// Makes a canvas as fine as the display and gives its context, in CSS pixels.
function fineContext(canvas, width, height) {
  const fine = window.devicePixelRatio || 1;
  const [w, h] = [Math.round(width * fine), Math.round(height * fine)];
  if (canvas.width !== w || canvas.height !== h) Object.assign(canvas, { width: w, height: h });
  const context = canvas.getContext("2d");
  context.setTransform(fine, 0, 0, fine, 0, 0);
  context.clearRect(0, 0, width, height);
  return context;
}

// Draws the part of a picture that a window of some size around the spot shows; scale shrinks the window's view of it.
function drawSpot(context, picture, spot, width, height, scale = 1) {
  const zoom = spot.zoom * scale;
  context.imageSmoothingEnabled = zoom < 1;
  context.imageSmoothingQuality = "high";
  context.drawImage(picture, width / 2 - spot.x * zoom, height / 2 - spot.y * zoom, spot.width * zoom, spot.height * zoom);
}

// Values written on the pixels in view.
function writeValues(context, spot, from, to, valueAt) {
  if (spot.zoom < NUMBERS_FROM) return;
  const [x0, y0] = spot.imageAt(0, 0).map(Math.floor), [x1, y1] = spot.imageAt(spot.windowWidth, spot.windowHeight).map(Math.floor);
  context.font = `${Math.min(13, spot.zoom / 3.6)}px system-ui, sans-serif`;
  context.textAlign = "center";
  context.textBaseline = "middle";
  for (let y = Math.max(0, y0); y <= Math.min(spot.height - 1, y1); y++) {
    for (let x = Math.max(0, x0); x <= Math.min(spot.width - 1, x1); x++) {
      const [px, py] = spot.windowAt(x + 0.5, y + 0.5), { text, dark } = valueAt(x, y);
      if (px < from || px >= to || !text) continue;
      context.fillStyle = dark ? "#fffc" : "#000c";
      context.fillText(text, px, py);
    }
  }
}
