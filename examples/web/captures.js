// Photographs with a light file, as the stereo graph takes them.

import { readPicture, toLinear } from "./pictures.js";

export class CaptureError extends Error {}

const LIGHT_FILES = ["light_directions.txt", "lights.txt", "lights.csv"];
const PICTURE = /\.(png|jpe?g|webp)$/i;
const NO_PHOTOGRAPH = /^(mask|normal|ambient)/i;
const natural = new Intl.Collator("en", { numeric: true }).compare;

/** Returns {feeds, width, height, count}, cropped to the mask. */
export async function readCapture(files, encoding, say) {
  const byName = new Map(files.map((file) => [file.name.toLowerCase(), file]));
  const names = await photographNames(byName);
  const lights = await readLights(byName, names);
  if (names.length < 3) throw new CaptureError(`Photometric stereo needs 3 photographs or more; these are ${names.length}.`);
  const intensities = await readIntensities(byName, names.length);
  const maskFile = [...byName.values()].find((file) => /^mask\.(png|jpe?g|webp)$/i.test(file.name));
  let box = null;
  const images = [];
  for (const [k, name] of names.entries()) {
    say(`Reading photograph ${k + 1} of ${names.length}…`);
    const picture = await readPicture(byName.get(name));
    box ??= await crop(maskFile, picture);
    if (picture.width !== box.width || picture.height !== box.height)
      throw new CaptureError(
        `${name} is ${picture.width} × ${picture.height}, the first is ${box.width} × ${box.height}: all must be of one size.`,
      );
    images.push(cut(picture, box, encoding, intensities[k]));
  }
  const [height, width] = [box.bottom - box.top, box.right - box.left];
  const all = new Float32Array(images.length * 3 * height * width);
  images.forEach((image, k) => all.set(image, k * image.length));
  const feeds = {
    images: { data: all, dims: [images.length, 3, height, width] },
    lights: { data: Float32Array.from(lights.flat()), dims: [lights.length, 3] },
    mask: { data: box.mask, dims: [1, height, width], type: "bool" },
  };
  return { feeds, width, height, count: images.length };
}

async function photographNames(byName) {
  const listed = byName.get("filenames.txt");
  const lp = [...byName.keys()].find((name) => name.endsWith(".lp"));
  let names;
  if (lp) names = (await lines(byName.get(lp))).filter((words) => words.length >= 4).map((words) => words.slice(0, -3).join(" "));
  else if (listed) names = (await lines(listed)).map((words) => words.join(" "));
  else names = [...byName.keys()].filter((name) => PICTURE.test(name) && !NO_PHOTOGRAPH.test(name)).sort(natural);
  names = names.map((name) => name.toLowerCase().split(/[\\/]/).pop());
  const missing = names.filter((name) => !byName.has(name));
  if (missing.length) throw new CaptureError(`${missing[0]} is named in the list of photographs but was not given.`);
  return names;
}

async function lines(file) {
  return (await file.text()).split(/\r?\n/).map((line) => line.split("#")[0].trim().split(/[\s,]+/).filter(Boolean))
    .filter((words) => words.length);
}

async function numbers(file, widths) {
  const rows = (await lines(file)).map((words) => words.map(Number));
  if (!rows.length || !rows.every((row) => widths.includes(row.length) && row.every(Number.isFinite)))
    throw new CaptureError(`${file.name} should have ${widths.join(" or ")} numbers in every line.`);
  return rows;
}

async function readLights(byName, names) {
  const lp = [...byName.keys()].find((name) => name.endsWith(".lp"));
  const file = lp ? null : LIGHT_FILES.map((name) => byName.get(name)).find(Boolean);
  if (!lp && !file) throw new CaptureError(`There is no light file: add ${LIGHT_FILES.join(" or ")} (a line x y z per photograph), or an .lp file.`);
  const rows = lp
    ? (await lines(byName.get(lp))).filter((words) => words.length >= 4).map((words) => words.slice(-3).map(Number))
    : await numbers(file, [3]);
  if (rows.length !== names.length)
    throw new CaptureError(`${rows.length} lights but ${names.length} photographs: one line is needed for each.`);
  return rows.map((row) => {
    const length = Math.hypot(...row);
    if (!(length > 0)) throw new CaptureError("A light direction is not a vector of three numbers.");
    return row.map((value) => value / length);
  });
}

async function readIntensities(byName, count) {
  const file = byName.get("light_intensities.txt");
  if (!file) return Array.from({ length: count }, () => [1, 1, 1]);
  const rows = await numbers(file, [1, 3]);
  if (rows.length !== count) throw new CaptureError(`${rows.length} intensities but ${count} photographs.`);
  return rows.map((row) => (row.length === 1 ? [row[0], row[0], row[0]] : row));
}

async function crop(file, { width, height }) {
  const inside = new Uint8Array(width * height).fill(1);
  if (file) {
    const picture = await readPicture(file);
    if (picture.width !== width || picture.height !== height)
      throw new CaptureError(`The mask is ${picture.width} × ${picture.height}, the photographs are ${width} × ${height}.`);
    for (let i = 0; i < inside.length; i++) inside[i] = picture.planes[i] > 0.5;
  }
  const box = { width, height, left: width, right: 0, top: height, bottom: 0 };
  for (let i = 0; i < inside.length; i++) {
    if (!inside[i]) continue;
    const [row, column] = [Math.floor(i / width), i % width];
    box.left = Math.min(box.left, column);
    box.right = Math.max(box.right, column + 1);
    box.top = Math.min(box.top, row);
    box.bottom = Math.max(box.bottom, row + 1);
  }
  if (!box.right) throw new CaptureError("The mask is empty.");
  box.mask = new Uint8Array((box.bottom - box.top) * (box.right - box.left));
  for (let row = box.top, k = 0; row < box.bottom; row++)
    for (let column = box.left; column < box.right; column++) box.mask[k++] = inside[row * width + column];
  return box;
}

function cut({ planes, width, height, bits }, box, encoding, intensity) {
  const curved = encoding === "srgb" || (encoding === "auto" && bits === 8);
  const table = curved && bits === 8 ? Float32Array.from({ length: 256 }, (_, k) => toLinear(k / 255)) : null;
  const result = new Float32Array(3 * (box.bottom - box.top) * (box.right - box.left));
  let k = 0;
  for (let c = 0; c < 3; c++)
    for (let row = box.top; row < box.bottom; row++)
      for (let column = box.left; column < box.right; column++) {
        const value = planes[(c * height + row) * width + column];
        result[k++] = (table ? table[Math.round(value * 255)] : curved ? toLinear(value) : value) / intensity[c];
      }
  return result;
}
