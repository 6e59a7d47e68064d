// Layers over the sensor's image that show the field between the markers.
const FINER = 8; // the heat map is made smooth at so many points for each marker, and then enlarged

export class FieldLayers {
  constructor() {
    this.small = document.createElement("canvas");
    this.finer = document.createElement("canvas");
  }

  greet(hello) {
    const [rows, columns] = hello.grid ?? [0, 0];
    this.whole = rows > 1 && columns > 1 && rows * columns === hello.reference_px.length;
    if (!this.whole) return;
    [this.small.width, this.small.height] = [columns, rows];
    [this.finer.width, this.finer.height] = [FINER * columns, FINER * rows];
    this.pixels = this.small.getContext("2d").createImageData(columns, rows);
    this.words = new Uint32Array(this.pixels.data.buffer);
    this.affine = affineOf(hello.reference_px, rows, columns);
  }

  // Displacement between the markers, as colours. Only a small picture is made smooth by cubic
  // curves: done for each pixel of the page, they cost more than everything else together.
  drawHeat(sensor, moved, context, zoom) {
    if (!this.whole) return;
    for (let i = 0; i < this.words.length; i++) this.words[i] = sensor.heatWord(moved[i]);
    this.small.getContext("2d").putImageData(this.pixels, 0, 0);
    const [width, height] = [this.finer.width, this.finer.height], smooth = this.finer.getContext("2d");
    smooth.clearRect(0, 0, width, height);
    [smooth.imageSmoothingEnabled, smooth.imageSmoothingQuality] = [true, "high"];
    smooth.drawImage(this.small, 0, 0, width, height);
    const [[ax, ay], [bx, by], [ox, oy]] = this.affine;
    context.save();
    context.setTransform(ax * zoom, ay * zoom, bx * zoom, by * zoom, (ox + 0.5) * zoom, (oy + 0.5) * zoom);
    context.imageSmoothingEnabled = true;
    context.imageSmoothingQuality = "low";
    context.drawImage(this.finer, -0.5, -0.5, this.small.width, this.small.height);
    context.restore();
  }

  drawMesh(sensor, tips) {
    if (!this.whole) return;
    const { context } = sensor, columns = this.small.width, rows = this.small.height;
    context.strokeStyle = sensor.tone.mesh;
    context.lineWidth = devicePixelRatio; // thicker lines are outlines to fill, at four times the cost
    context.beginPath();
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) joined(context, sensor, tips[row * columns + column], column === 0);
    }
    for (let column = 0; column < columns; column++) {
      for (let row = 0; row < rows; row++) joined(context, sensor, tips[row * columns + column], row === 0);
    }
    context.stroke();
  }
}

function joined(context, sensor, tip, first) {
  const [x, y] = sensor.toCanvas(tip[2], tip[3]);
  if (first) context.moveTo(x, y);
  else context.lineTo(x, y);
}

// The steps to the next column and the next row, and the first marker's place, of the mean grid.
function affineOf(reference, rows, columns) {
  const mean = (pick) => [0, 1].map((axis) => {
    let sum = 0, count = 0;
    for (let row = 0; row < rows; row++) {
      for (let column = 0; column < columns; column++) {
        const value = pick(row, column, axis);
        if (value !== null) [sum, count] = [sum + value, count + 1];
      }
    }
    return sum / count;
  });
  const at = (row, column, axis) => reference[row * columns + column][axis];
  const across = mean((row, column, axis) => (column + 1 < columns ? at(row, column + 1, axis) - at(row, column, axis) : null));
  const down = mean((row, column, axis) => (row + 1 < rows ? at(row + 1, column, axis) - at(row, column, axis) : null));
  const middle = mean(at);
  return [across, down, middle.map((value, axis) => value - across[axis] * (columns - 1) / 2 - down[axis] * (rows - 1) / 2)];
}
