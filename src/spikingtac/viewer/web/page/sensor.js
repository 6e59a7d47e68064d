// Draws the sensor: image, discs, truth and arrows. Positions are in sensor pixels whose centres
// are whole numbers, so that half a pixel lies between a position and the canvas's corner.
import { FieldLayers } from "./layers.js";
import { colors, fitCanvas } from "./theme.js";

const AGE_BINS = 7;
const OFF_CODE = 8;
const MAP_LEVELS = 15;
const CHOOSE_WITHIN_PX = 25;
const SHAFT_PX = 1.6;
const HEAD_SHARE = 0.35;
const LONGEST_HEAD_PX = 7;
const MOST_OPAQUE = 0.7; // of the heat map
const SCALE_STEPS = 64; // colours of the scale
const SHORTEST_ARROW_PX = 0.35; // below it, in sensor pixels, a dot says more than an arrow

export class Sensor {
  constructor(canvas) {
    this.canvas = canvas;
    this.context = canvas.getContext("2d", { alpha: false });
    this.picture = document.createElement("canvas");
    this.options = { image: "surface", scale: 2, arrows: true, heat: false, mesh: false, discs: true, truth: false, marker: 0 };
    this.layers = new FieldLayers();
    this.top = 1; // px of displacement at the end of the colour scale
    this.arrows = [];
  }

  greet(hello) {
    this.hello = hello;
    this.layers.greet(hello);
    [this.picture.width, this.picture.height] = hello.view_size;
    this.pixels = this.picture.getContext("2d").createImageData(...hello.view_size);
    this.words = new Uint32Array(this.pixels.data.buffer);
    document.documentElement.style.setProperty("--aspect", hello.size[0] / hello.size[1]);
    this.recolor();
  }

  recolor() {
    const tone = colors();
    const ground = rgb(tone.image);
    const fade = (color, image) => Array.from({ length: 16 }, (_, code) => {
      const age = code >= OFF_CODE ? code - OFF_CODE : code;
      const target = rgb(code >= OFF_CODE ? tone.off : tone.on);
      const share = age === 0 ? 0 : image === "events" ? 0.85 : 0.12 + 0.88 * (age / AGE_BINS) ** 2;
      return word(ground.map((from, i) => from + (target[i] - from) * share));
    });
    const white = rgb(tone.text);
    this.tables = {
      surface: fade(tone, "surface"),
      events: fade(tone, "events"),
      map: Array.from({ length: 16 }, (_, code) =>
        word(ground.map((from, i) => from + (white[i] - from) * 0.8 * (code / MAP_LEVELS)))),
    };
    this.tone = tone;
    const stops = [0, 1, 2, 3, 4].map((stop) => rgb(tone[`scale-${stop}`]));
    this.scale = Array.from({ length: SCALE_STEPS }, (_, step) => {
      const at = 4 * step / (SCALE_STEPS - 1), low = Math.min(Math.floor(at), 3);
      return stops[low].map((from, i) => from + (stops[low + 1][i] - from) * (at - low));
    });
    this.scaleWords = this.scale.map(word);
    this.scaleTexts = this.scale.map((color) => `rgb(${color.map(Math.round).join()})`);
  }

  scaleStep(moved) {
    return Math.min(Math.floor(SCALE_STEPS * moved / this.top), SCALE_STEPS - 1);
  }

  // Colour of the heat map: where the skin has not moved, the image is seen.
  heatWord(moved) {
    const opaque = Math.round(255 * MOST_OPAQUE * Math.min(3 * moved / this.top, 1));
    return (this.scaleWords[this.scaleStep(moved)] & 0xffffff | opaque << 24) >>> 0;
  }

  toCanvas(x, y) {
    return [(x + 0.5) * this.zoom, (y + 0.5) * this.zoom];
  }

  draw({ arrays }) {
    if (!this.hello) return;
    fitCanvas(this.canvas);
    this.zoom = Math.min(this.canvas.width / this.hello.size[0], this.canvas.height / this.hello.size[1]);
    this.context.fillStyle = this.tone.image;
    this.context.fillRect(0, 0, this.canvas.width, this.canvas.height);
    this.drawImage(arrays);
    this.follow(arrays);
    if (this.options.heat && this.moved.length) this.layers.drawHeat(this, this.moved);
    if (this.options.discs) this.drawDiscs(this.hello.reference_px, this.tone.disc);
    if (this.options.mesh && this.arrows.length) this.layers.drawMesh(this, this.arrows);
    if (this.options.truth && arrays.truth_px) this.drawDiscs(pairs(arrays.truth_px), this.tone.truth);
    if (this.arrows.length) this.drawArrows(arrays);
  }

  drawImage(arrays) {
    const image = this.options.image;
    const packed = image === "map" ? arrays.map : image === "none" ? undefined : arrays.activity;
    if (!packed) return;
    const table = this.tables[image], words = this.words;
    for (let i = 0, pixel = 0; pixel < words.length; i++) {
      words[pixel++] = table[packed[i] >> 4];
      if (pixel < words.length) words[pixel++] = table[packed[i] & 15];
    }
    this.picture.getContext("2d").putImageData(this.pixels, 0, 0);
    this.context.imageSmoothingEnabled = false;
    const [width, height] = this.hello.view_size, step = this.hello.view_step * this.zoom;
    this.context.drawImage(this.picture, 0, 0, width * step, height * step);
  }

  drawDiscs(centers, color) {
    const context = this.context, ratio = devicePixelRatio;
    context.strokeStyle = color;
    context.lineWidth = ratio;
    context.beginPath();
    centers.forEach(([x, y], marker) => {
      const [cx, cy] = this.toCanvas(x, y), radius = this.hello.radius_px[marker] * this.zoom;
      context.moveTo(cx + radius, cy);
      context.arc(cx, cy, radius, 0, 2 * Math.PI);
    });
    context.stroke();
  }

  // Where each arrow begins and ends, and how far its marker has moved.
  follow({ position_px: position }) {
    [this.arrows, this.moved] = [[], []];
    if (!position) return;
    this.hello.reference_px.forEach(([rx, ry], marker) => {
      const dx = position[2 * marker] - rx, dy = position[2 * marker + 1] - ry;
      this.arrows.push([rx, ry, rx + dx * this.options.scale, ry + dy * this.options.scale]);
      this.moved.push(Math.hypot(dx, dy));
    });
  }

  drawArrows({ position_px: position, held, confidence }) {
    const context = this.context, dash = [4 * devicePixelRatio, 3 * devicePixelRatio];
    if (this.options.arrows) {
      this.arrows.forEach(([rx, ry, tx, ty], marker) => {
        const sustained = held[marker] === 1, lost = sustained && confidence[marker] === 0;
        // On the heat map the same colours would not be seen.
        const plain = this.options.heat ? this.tone.text : this.scaleTexts[this.scaleStep(this.moved[marker])];
        context.strokeStyle = context.fillStyle = lost ? this.tone.lost : sustained ? this.tone.held : plain;
        context.setLineDash(sustained ? dash : []);
        this.arrow(this.toCanvas(rx, ry), this.toCanvas(tx, ty), this.moved[marker]);
        if (lost) this.cross(...this.toCanvas(rx, ry));
      });
      context.setLineDash([]);
    }
    this.ring(position);
  }

  cross(x, y) {
    const context = this.context, size = 4 * devicePixelRatio;
    context.setLineDash([]);
    context.beginPath();
    for (const way of [1, -1]) {
      context.moveTo(x - size, y - way * size);
      context.lineTo(x + size, y + way * size);
    }
    context.stroke();
  }

  arrow([x0, y0], [x1, y1], length) {
    const context = this.context, ratio = devicePixelRatio;
    if (length < SHORTEST_ARROW_PX) {
      context.beginPath();
      context.arc(x1, y1, 1.5 * ratio, 0, 2 * Math.PI);
      context.fill();
      return;
    }
    const angle = Math.atan2(y1 - y0, x1 - x0);
    const head = Math.min(LONGEST_HEAD_PX * ratio, HEAD_SHARE * Math.hypot(x1 - x0, y1 - y0) + 2 * ratio);
    context.lineWidth = SHAFT_PX * ratio;
    context.beginPath();
    context.moveTo(x0, y0);
    context.lineTo(x1 - 0.8 * head * Math.cos(angle), y1 - 0.8 * head * Math.sin(angle));
    context.stroke();
    context.beginPath();
    context.moveTo(x1, y1);
    for (const turn of [-0.42, 0.42]) {
      context.lineTo(x1 - head * Math.cos(angle + turn), y1 - head * Math.sin(angle + turn));
    }
    context.fill();
  }

  ring(position) {
    const marker = this.options.marker;
    const [x, y] = this.toCanvas(position[2 * marker], position[2 * marker + 1]);
    this.context.strokeStyle = this.tone.text;
    this.context.lineWidth = 1.5 * devicePixelRatio;
    this.context.beginPath();
    this.context.arc(x, y, (this.hello.radius_px[marker] + 2) * this.zoom, 0, 2 * Math.PI);
    this.context.stroke();
  }

  markerAt(event) {
    const box = this.canvas.getBoundingClientRect();
    const zoom = Math.min(box.width / this.hello.size[0], box.height / this.hello.size[1]);
    const x = (event.clientX - box.left) / zoom - 0.5, y = (event.clientY - box.top) / zoom - 0.5;
    const far = this.hello.reference_px.map(([rx, ry]) => Math.hypot(rx - x, ry - y));
    const nearest = far.indexOf(Math.min(...far));
    return far[nearest] < CHOOSE_WITHIN_PX ? nearest : null;
  }
}

function pairs(flat) {
  return Array.from({ length: flat.length / 2 }, (_, i) => [flat[2 * i], flat[2 * i + 1]]);
}

function rgb(hex) {
  return [1, 3, 5].map((start) => parseInt(hex.slice(start, start + 2), 16));
}

function word([red, green, blue]) {
  return (255 << 24 | Math.round(blue) << 16 | Math.round(green) << 8 | Math.round(red)) >>> 0;
}
