// What the page saves: normals and heights as 16-bit PNG, albedo, and the surface as a GLB.

import { encode } from "fast-png";
import { toSrgb } from "./pictures.js";

function download(name, data, type) {
  const link = document.createElement("a");
  link.download = name;
  link.href = URL.createObjectURL(new Blob([data], { type }));
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 60_000);
}

function savePng(name, { width, height }, channels, value) {
  const count = width * height;
  const data = new Uint16Array(channels * count);
  for (let i = 0; i < count; i++)
    for (let c = 0; c < channels; c++)
      data[channels * i + c] = Math.round(Math.min(Math.max(value(i, c), 0), 1) * 65535);
  download(name, encode({ width, height, data, channels, depth: 16 }), "image/png");
}

const isThere = ({ normals, width, height }, i) =>
  normals[i] !== 0 || normals[width * height + i] !== 0 || normals[2 * width * height + i] !== 0;

/** Unit normals as colours, green up, black where nothing is. */
export function saveNormals(surface) {
  const count = surface.width * surface.height;
  savePng("normal.png", surface, 3, (i, c) => (isThere(surface, i) ? (surface.normals[c * count + i] + 1) / 2 : 0));
}

/** Albedo as sRGB; 1 is white. */
export function saveAlbedo(surface) {
  const count = surface.width * surface.height;
  savePng("albedo.png", surface, 3, (i, c) => (surface.albedo ? toSrgb(surface.albedo[c * count + i]) : 0));
}

/** Heights from the lowest, black, to the highest, white. */
export function saveHeights(surface, depth) {
  const { low, high } = range(surface, depth);
  savePng("height.png", surface, 1, (i) => (isThere(surface, i) ? (depth[i] - low) / Math.max(high - low, 1e-9) : 0));
  return high - low;
}

function range(surface, depth) {
  let [low, high] = [Infinity, -Infinity];
  for (let i = 0; i < depth.length; i++) {
    if (!isThere(surface, i)) continue;
    low = Math.min(low, depth[i]);
    high = Math.max(high, depth[i]);
  }
  return { low, high };
}

/** The surface in pixels, x right, y up, z toward the viewer, with colours of its vertices; a 3D program opens it. */
export async function saveGlb(surface, depth) {
  const { BufferAttribute, BufferGeometry, Mesh, MeshStandardMaterial } = await import("three");
  const { GLTFExporter } = await import("three/addons/exporters/GLTFExporter.js");
  const { width, height, normals, albedo } = surface;
  const count = width * height;
  const index = new Int32Array(count).fill(-1);
  const [points, directions, colours, corners] = [[], [], [], []];
  for (let i = 0; i < count; i++) {
    if (!isThere(surface, i)) continue;
    index[i] = points.length / 3;
    points.push((i % width) - width / 2, height / 2 - Math.floor(i / width), depth[i]);
    for (let c = 0; c < 3; c++) {
      directions.push(normals[c * count + i]);
      colours.push(albedo ? Math.min(albedo[c * count + i], 1) : 0.8);
    }
  }
  for (let i = 0; i + width < count; i++) {
    if (i % width === width - 1) continue;
    const [a, b, c, d] = [index[i], index[i + 1], index[i + width], index[i + width + 1]];
    if (a >= 0 && b >= 0 && c >= 0) corners.push(a, c, b);
    if (b >= 0 && c >= 0 && d >= 0) corners.push(b, c, d);
  }
  const geometry = new BufferGeometry();
  for (const [name, values] of [["position", points], ["normal", directions], ["color", colours]])
    geometry.setAttribute(name, new BufferAttribute(Float32Array.from(values), 3));
  geometry.setIndex(new BufferAttribute(Uint32Array.from(corners), 1));
  const material = new MeshStandardMaterial({ vertexColors: true, roughness: 1, metalness: 0 });
  const file = await new GLTFExporter().parseAsync(new Mesh(geometry, material), { binary: true });
  download("surface.glb", file, "model/gltf-binary");
  return corners.length / 3;
}
