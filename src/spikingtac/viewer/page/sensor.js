// Draws the sensor: image, discs, truth and arrows. Positions are in sensor pixels whose centres
// are whole numbers, so that half a pixel lies between a position and the canvas's corner.
import { drawSeen, drawSustained } from "./arrows.js";
import { FieldLayers } from "./layers.js";
import { colors, fitCanvas } from "./theme.js";

const AGE_BINS = 7;
const OFF_CODE = 8;
const MAP_LEVELS = 15;
const CHOOSE_WITHIN_PX = 25;
const MOST_OPAQUE = 0.7; // of the heat map
const SCALE_STEPS = 64; // colours of the scale
const ARROW_STEPS = 16; // colours of the arrows: those of one colour are one path

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
    this.follow(arrays);
    this.drawImage(arrays);
    if (this.options.discs) this.drawDiscs(this.hello.reference_px, this.tone.disc);
    if (this.options.mesh && this.arrows.length) this.layers.drawMesh(this, this.arrows);
    if (this.options.truth && arrays.truth_px) this.drawDiscs(pairs(arrays.truth_px), this.tone.truth);
    if (this.arrows.length) this.drawArrows(arrays);
  }

  // Events and heat map are laid over each other at the sensor's own pixels, and enlarged once.
  drawImage(arrays) {
    const heat = this.options.heat && this.moved.length > 0, shown = this.fillPicture(arrays);
    if (!shown && !heat) return this.ground(0, 0);
    const [width, height] = this.hello.view_size, step = this.hello.view_step, onto = this.picture.getContext("2d");
    if (!shown) {
      onto.fillStyle = this.tone.image;
      onto.fillRect(0, 0, width, height);
    }
    if (heat) this.layers.drawHeat(this, this.moved, onto, 1 / step);
    const right = width * step * this.zoom, below = height * step * this.zoom;
    this.context.imageSmoothingEnabled = false;
    this.context.drawImage(this.picture, 0, 0, right, below);
    this.ground(Math.floor(right), Math.floor(below));
  }

  // Draw the chosen image into the small picture; false where there is none.
  fillPicture(arrays) {
    const image = this.options.image;
    const packed = image === "map" ? arrays.map : image === "none" ? undefined : arrays.activity;
    if (!packed) return false;
    const table = this.tables[image], words = this.words, eight = new Uint32Array(packed.buffer, packed.byteOffset, packed.length >> 2);
    words.fill(table[0]); // most pixels are empty: where eight of them are, nothing is left to do
    for (let i = 0; i < packed.length; i++) {
      if ((i & 3) === 0 && eight[i >> 2] === 0) { i += 3; continue; }
      words[2 * i] = table[packed[i] >> 4];
      if (2 * i + 1 < words.length) words[2 * i + 1] = table[packed[i] & 15];
    }
    this.picture.getContext("2d").putImageData(this.pixels, 0, 0);
    return true;
  }

  // What the image leaves free, right of and below a point.
  ground(right, below) {
    const { width, height } = this.canvas;
    this.context.fillStyle = this.tone.image;
    if (width > right) this.context.fillRect(right, 0, width - right, height);
    if (height > below) this.context.fillRect(0, below, right, height - below);
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
    if (this.options.arrows) {
      const seen = new Map(), sustained = [];
      this.arrows.forEach(([rx, ry, tx, ty], marker) => {
        const ends = [this.toCanvas(rx, ry), this.toCanvas(tx, ty), this.moved[marker]];
        if (held[marker] === 1) return sustained.push([ends, confidence[marker] === 0]);
        // On the heat map the same colours would not be seen.
        const color = this.options.heat ? this.tone.text : this.scaleTexts[this.arrowStep(this.moved[marker])];
        if (!seen.has(color)) seen.set(color, []);
        seen.get(color).push(ends);
      });
      drawSeen(this.context, seen);
      drawSustained(this.context, sustained, this.tone);
    }
    this.ring(position);
  }

  arrowStep(moved) {
    const width = SCALE_STEPS / ARROW_STEPS;
    return Math.floor(this.scaleStep(moved) / width) * width + width - 1;
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
