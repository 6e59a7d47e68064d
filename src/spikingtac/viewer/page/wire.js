// Reads the frame message: "STV1", length, JSON, arrays (see wire.py).
const TYPES = { f4: Float32Array, u1: Uint8Array, u2: Uint16Array, u4: Uint32Array };
const PREFIX_BYTES = 8;

export function decode(buffer) {
  const view = new DataView(buffer);
  if (view.getUint32(0, false) !== 0x53545631) throw new Error("not a frame message");
  const length = view.getUint32(4, true);
  const text = new TextDecoder().decode(new Uint8Array(buffer, PREFIX_BYTES, length));
  const meta = JSON.parse(text);
  const body = PREFIX_BYTES + length;
  const arrays = {};
  for (const [name, kind, shape, offset] of meta.arrays) {
    const items = shape.reduce((product, side) => product * side, 1);
    arrays[name] = new TYPES[kind](buffer, body + offset, items);
  }
  return { meta, arrays };
}
