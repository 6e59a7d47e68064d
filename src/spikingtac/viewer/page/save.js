// Files that the page makes by itself: a picture of the sensor, and a table of what was drawn.
const LINE_PX = 18, MARGIN_PX = 12;

export function savePicture(sensor, title, entries) {
  const { canvas, tone } = sensor, ratio = devicePixelRatio;
  const out = document.createElement("canvas"), context = out.getContext("2d");
  const line = LINE_PX * ratio, margin = MARGIN_PX * ratio;
  context.font = `${12 * ratio}px system-ui, sans-serif`;
  const lines = wrapped(context, [title, ...entries], canvas.width - 2 * margin);
  [out.width, out.height] = [canvas.width, canvas.height + lines.length * line + 2 * margin];
  context.fillStyle = tone.panel;
  context.fillRect(0, 0, out.width, out.height);
  context.drawImage(canvas, 0, 0);
  context.font = `${12 * ratio}px system-ui, sans-serif`;
  context.fillStyle = tone.text;
  context.textBaseline = "top";
  lines.forEach((said, index) => context.fillText(said, margin, canvas.height + margin + index * line));
  out.toBlob((blob) => download(blob, `${fileName(title)}.png`), "image/png");
}

export function saveTable(course, hello, title) {
  const scale = hello.px_per_mm, head = ["t_us", "marker", "dx_px", "dy_px", ...(scale ? ["dx_mm", "dy_mm"] : [])];
  const rows = [head.join(",")];
  for (const { t_us: tUs, moved } of course.inOrder()) {
    for (let marker = 0; 2 * marker < moved.length; marker++) {
      const px = [moved[2 * marker], moved[2 * marker + 1]];
      rows.push([tUs, marker, ...px.map(fixed), ...(scale ? px.map((value) => fixed(value / scale)) : [])].join(","));
    }
  }
  download(new Blob([`${rows.join("\n")}\n`], { type: "text/csv" }), `${fileName(title)}.csv`);
}

function fixed(value) {
  const said = value.toFixed(4);
  return said === "-0.0000" ? "0.0000" : said;
}

function wrapped(context, parts, width) {
  const lines = [parts[0]];
  let line = "";
  for (const part of parts.slice(1)) {
    const longer = line ? `${line}  ·  ${part}` : part;
    if (line && context.measureText(longer).width > width) {
      lines.push(line);
      line = part;
    } else line = longer;
  }
  return line ? [...lines, line] : lines;
}

function fileName(title) {
  return title.replace(/[^\w.-]+/g, "_") || "spikingtac";
}

function download(blob, name) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  window.__m.saved = { name, bytes: blob.size };
  setTimeout(() => URL.revokeObjectURL(link.href), 1000);
}
