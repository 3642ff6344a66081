// A mesh file as vertices and faces that fit the renderer's unit sphere.

import { mergeVertices } from "three/addons/utils/BufferGeometryUtils.js";

export class MeshError extends Error {}

const READERS = {
  obj: async (bytes) => {
    const { OBJLoader } = await import("three/addons/loaders/OBJLoader.js");
    return new OBJLoader().parse(new TextDecoder().decode(bytes)).children.map((part) => part.geometry);
  },
  ply: async (bytes) => {
    const { PLYLoader } = await import("three/addons/loaders/PLYLoader.js");
    return [new PLYLoader().parse(bytes)];
  },
  stl: async (bytes) => {
    const { STLLoader } = await import("three/addons/loaders/STLLoader.js");
    return [new STLLoader().parse(bytes)];
  },
};

/** Returns {vertices: Float32Array (V, 3), faces: BigInt64Array (F, 3)}. */
export async function readMesh(file) {
  const kind = file.name.toLowerCase().split(".").pop();
  let parts;
  try {
    parts = (await READERS[kind](await file.arrayBuffer())).filter((part) => part.getAttribute("position")?.count);
  } catch (error) {
    throw new MeshError(`${file.name} is not a mesh that can be read (${error.message}).`);
  }
  const vertices = [];
  const faces = [];
  for (const part of parts) {
    for (const name of Object.keys(part.attributes)) if (name !== "position") part.deleteAttribute(name);
    const merged = mergeVertices(part, 0);
    const first = BigInt(vertices.length / 3);
    for (const value of merged.getAttribute("position").array) vertices.push(value);
    for (const value of merged.index.array) faces.push(first + BigInt(value));
  }
  if (!faces.length) throw new MeshError(`${file.name} has no faces.`);
  if (!vertices.every(Number.isFinite)) throw new MeshError(`${file.name} has vertices that are not finite.`);
  return { vertices: fit(vertices), faces: BigInt64Array.from(faces) };
}

function fit(vertices) {
  const low = [Infinity, Infinity, Infinity];
  const high = [-Infinity, -Infinity, -Infinity];
  vertices.forEach((value, k) => {
    low[k % 3] = Math.min(low[k % 3], value);
    high[k % 3] = Math.max(high[k % 3], value);
  });
  const radius = Math.max(Math.hypot(...high.map((value, k) => value - low[k])) / 2, 1e-12);
  return Float32Array.from(vertices, (value, k) => (value - (low[k % 3] + high[k % 3]) / 2) / radius);
}

/** Rotates the vertices about the y axis by an angle in degrees. */
export function turned(vertices, degrees) {
  const [c, s] = [Math.cos((degrees * Math.PI) / 180), Math.sin((degrees * Math.PI) / 180)];
  const result = new Float32Array(vertices.length);
  for (let k = 0; k < vertices.length; k += 3) {
    result[k] = c * vertices[k] + s * vertices[k + 2];
    result[k + 1] = vertices[k + 1];
    result[k + 2] = c * vertices[k + 2] - s * vertices[k];
  }
  return result;
}
