// Unpacking of arrays from `packing.py`: rows as differences from the previous row, in byte planes.

const UINTS = { 1: Uint8Array, 2: Uint16Array, 4: Uint32Array };

/** Inflated bytes of the base64 text of an element. */
async function inflated(element) {
  const text = atob(element.textContent.trim());
  element.remove();
  const bytes = new Uint8Array(text.length);
  for (let i = 0; i < text.length; i++) bytes[i] = text.charCodeAt(i);
  const stream = new Blob([bytes]).stream().pipeThrough(new DecompressionStream("deflate"));
  return new Uint8Array(await new Response(stream).arrayBuffer());
}

/** Integers of an array; typed arrays wrap around like NumPy's unsigned integers. */
function unpacked(data, { offset, rows, columns, bytes }) {
  const count = rows * columns, found = new UINTS[bytes](count);
  for (let i = 0; i < count; i++) {
    let value = i < columns ? 0 : found[i - columns];
    let difference = 0;
    for (let b = 0; b < bytes; b++) difference |= data[offset + b * count + i] << (8 * b);
    found[i] = value + difference;
  }
  return found;
}

/** Floating-point numbers, packed as integers with the same bits. */
const unpackedFloats = (data, array) => new Float32Array(unpacked(data, array).buffer);
