// Reads pictures into planes of numbers, and draws planes on canvases; sRGB as in IEC 61966-2-1.

import { convertIndexedToRgb, decode } from "fast-png";

export class PictureError extends Error {}

// Entries of the table of the sRGB curve: fine enough that every 8-bit value is reached in its dark, steep part.
const FINE = 1 << 14;
const CURVE = Uint8ClampedArray.from({ length: FINE + 1 }, (_, k) => {
  return Math.round(255 * toSrgb(k / FINE));
});

export const toLinear = (value) => (value <= 0.04045 ? value / 12.92 : ((value + 0.055) / 1.055) ** 2.4);

export function toSrgb(light) {
  const value = Math.min(Math.max(light, 0), 1);
  return value <= 0.0031308 ? 12.92 * value : 1.055 * value ** (1 / 2.4) - 0.055;
}

/** Returns {width, height, bits, planes}: three planes of stored values in [0, 1], one after the other. */
export async function readPicture(file) {
  try {
    return file.name.toLowerCase().endsWith(".png") ? await readPng(file) : await readOther(file);
  } catch (error) {
    throw new PictureError(`${file.name} is not a picture that can be read (${error.message}).`);
  }
}

async function readPng(file) {
  const png = decode(new Uint8Array(await file.arrayBuffer()));
  const channels = png.palette ? png.palette[0].length : png.channels;
  const data = png.palette ? convertIndexedToRgb(png) : png.data;
  const depth = png.palette ? 8 : png.depth;
  if (depth < 8) throw new Error(`${depth} bits per channel`);
  const { width, height } = png;
  return { width, height, bits: depth, planes: toPlanes(data, width * height, channels, 2 ** depth - 1) };
}

async function readOther(file) {
  const bitmap = await createImageBitmap(file, { colorSpaceConversion: "none", premultiplyAlpha: "none" });
  const canvas = new OffscreenCanvas(bitmap.width, bitmap.height);
  const context = canvas.getContext("2d");
  context.drawImage(bitmap, 0, 0);
  const { data, width, height } = context.getImageData(0, 0, bitmap.width, bitmap.height);
  return { width, height, bits: 8, planes: toPlanes(data, width * height, 4, 255) };
}

function toPlanes(data, count, channels, top) {
  const planes = new Float32Array(3 * count);
  for (let c = 0; c < 3; c++) {
    const from = channels < 3 ? 0 : c;
    for (let i = 0; i < count; i++) planes[c * count + i] = data[i * channels + from] / top;
  }
  return planes;
}

/** Unit normals in the camera frame, three planes; black pixels are background. */
export function decodeNormals({ planes }, green) {
  const count = planes.length / 3;
  const normals = new Float32Array(planes.length);
  let away = 0;
  let filled = 0;
  for (let i = 0; i < count; i++) {
    const [r, g, b] = [planes[i], planes[count + i], planes[2 * count + i]];
    if (r === 0 && g === 0 && b === 0) continue;
    const [x, y, z] = [2 * r - 1, (2 * g - 1) * (green === "down" ? -1 : 1), 2 * b - 1];
    const length = Math.max(Math.hypot(x, y, z), 1e-12);
    normals[i] = x / length;
    normals[count + i] = y / length;
    normals[2 * count + i] = z / length;
    filled += 1;
    away += Math.abs(length - 1) > 0.2 || z < -0.2;
  }
  if (!filled || away > filled / 4) throw new PictureError("These colours are no normal map: most are no unit vectors.");
  return normals;
}

const image = { left: null, right: null, difference: null };

function imageOf(canvas, width, height) {
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  if (image[canvas.id]?.width !== width || image[canvas.id]?.height !== height)
    image[canvas.id] = new ImageData(width, height);
  return image[canvas.id];
}

/** Draws linear light, one plane or three, on a canvas as sRGB. */
export function drawLight(canvas, planes, width, height) {
  const target = imageOf(canvas, width, height);
  const count = width * height;
  const step = planes.length === count ? 0 : count;
  const pixels = new Uint32Array(target.data.buffer); // little-endian: A B G R
  for (let i = 0; i < count; i++) {
    const r = CURVE[Math.min(planes[i], 1) * FINE + 0.5 | 0];
    const g = step ? CURVE[Math.min(planes[i + step], 1) * FINE + 0.5 | 0] : r;
    const b = step ? CURVE[Math.min(planes[i + 2 * step], 1) * FINE + 0.5 | 0] : r;
    pixels[i] = 0xff000000 | (b << 16) | (g << 8) | r;
  }
  canvas.getContext("2d").putImageData(target, 0, 0);
}

/** Draws red where the first is brighter and blue where the second is; returns the largest difference. */
export function drawDifference(canvas, first, second, width, height) {
  const target = imageOf(canvas, width, height);
  const count = width * height;
  const pixels = new Uint32Array(target.data.buffer);
  let largest = 0;
  for (let i = 0; i < count; i++) {
    const more = first[i] - second[i];
    if (Math.abs(more) > largest) largest = Math.abs(more);
    const shown = Math.min(Math.abs(more) * 1020, 255) | 0;
    pixels[i] = more > 0 ? 0xff000000 | shown : 0xff000000 | (shown << 16);
  }
  canvas.getContext("2d").putImageData(target, 0, 0);
  return largest;
}
