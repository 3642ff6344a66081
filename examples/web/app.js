// The page: which surface is shown, under which light, by which models.

import { readCapture } from "./captures.js";
import { run, threads } from "./graphs.js";
import { readMesh, turned } from "./meshes.js";
import { decodeNormals, drawDifference, drawLight, readPicture, toLinear } from "./pictures.js";
import { saveAlbedo, saveGlb, saveHeights, saveNormals } from "./saves.js";

// MODELS in make_graphs.py
const NAMES = { lambert: "Lambert", qualitative: "Classic Oren-Nayar", vcavity: "V-cavity, all bounces" };
const SIDE = 512; // rows and columns that the renderer draws, SIZE in make_graphs.py
const at = (id) => document.getElementById(id);
const state = { normals: null, albedo: null, width: 0, height: 0, light: [0.3, 0.4], mesh: null, picture: null };

function say(text, wrong = false) {
  at("status").textContent = text;
  at("status").classList.toggle("wrong", wrong);
}

function fail(error) {
  say(error.message, true);
}

// --- Shading ------------------------------------------------------------------------------------------------------

let dirty = false;
let busy = false;
const times = { left: [], right: [] };
const warm = new Set();

function refresh() {
  dirty = true;
  if (!busy) requestAnimationFrame(frame);
}

async function frame() {
  if (busy || !dirty || !state.normals) return;
  busy = true;
  dirty = false;
  try {
    await show();
  } catch (error) {
    fail(error);
  }
  busy = false;
  if (dirty) requestAnimationFrame(frame);
}

async function show() {
  const { width, height } = state;
  const first = await shade("left", at("model").value);
  drawLight(at("left"), first, width, height);
  if (!at("compare").checked) return;
  const second = await shade("right", at("other").value);
  drawLight(at("right"), second, width, height);
  const largest = drawDifference(at("difference"), first, second, width, height);
  at("largest").textContent = `most: ${largest.toFixed(3)}`;
}

/** Linear light by one model, in one plane or three. */
async function shade(view, model) {
  const begun = performance.now();
  const { shading } = await run(`shading_${model}`, feeds(), at("device").value);
  const spent = performance.now() - begun;
  if (!warm.has(`${model} ${at("device").value}`)) {
    warm.add(`${model} ${at("device").value}`); // the first run loads the graph and makes its plan
    at(`${view}-time`).textContent = `loaded in ${spent.toFixed(0)} ms`;
    return shading.data;
  }
  times[view] = [...times[view].slice(-19), spent];
  const middle = [...times[view]].sort((a, b) => a - b)[times[view].length >> 1];
  at(`${view}-time`).textContent = `${middle.toFixed(1)} ms`;
  return shading.data;
}

function light() {
  const [x, y] = state.light;
  return [x, y, Math.sqrt(Math.max(1 - x * x - y * y, 0))];
}

function feeds() {
  const { width, height } = state;
  const one = (data) => ({ data: Float32Array.from(data), dims: [1, data.length, 1, 1] });
  const hex = at("tint").value;
  const tint = [1, 3, 5].map((k) => toLinear(parseInt(hex.slice(k, k + 2), 16) / 255));
  const share = at("albedo").value / 100;
  const grey = tint.every((value) => value === tint[0]);
  const even = one(grey ? [share * tint[0]] : tint.map((value) => share * value));
  return {
    normal: { data: state.normals, dims: [1, 3, height, width] },
    light: one(light()),
    view: one([0, 0, 1]),
    albedo: state.albedo ? { data: state.albedo, dims: [1, 3, height, width] } : even,
    roughness: one([(at("roughness").value * Math.PI) / 180]),
  };
}

// --- What is shown ------------------------------------------------------------------------------------------------

function surface(normals, width, height, albedo = null) {
  Object.assign(state, { normals, width, height, albedo });
  at("albedo").disabled = at("tint").disabled = albedo !== null;
  refresh();
}

async function openNormals(file) {
  const picture = await readPicture(file);
  surface(decodeNormals(picture, at("green").value), picture.width, picture.height);
  Object.assign(state, { picture, mesh: null });
  at("turn").disabled = true;
  say(`${file.name}: ${picture.width} × ${picture.height} normals.`);
}

async function openMesh(file) {
  say(`Reading ${file.name}…`);
  state.mesh = { ...(await readMesh(file)), name: file.name };
  state.picture = null;
  at("turn").disabled = false;
  await drawMesh();
}

async function drawMesh() {
  const { vertices, faces, name } = state.mesh;
  const begun = performance.now();
  const { normal } = await run("renderer", {
    vertices: { data: turned(vertices, Number(at("turn").value)), dims: [vertices.length / 3, 3] },
    faces: { data: faces, dims: [faces.length / 3, 3], type: "int64" },
  });
  surface(normal.data, SIDE, SIDE);
  say(`${name}: ${faces.length / 3} triangles drawn in ${(performance.now() - begun).toFixed(0)} ms.`);
}

let worker = null;

function runInWorker(name, given) {
  worker ??= new Worker(new URL("./worker.js", import.meta.url), { type: "module" });
  return new Promise((resolve, reject) => {
    worker.onmessage = ({ data }) => (data.error ? reject(new Error(data.error)) : resolve(data.found));
    worker.onerror = (event) => reject(new Error(event.message || "the solver stopped"));
    worker.postMessage({ name, feeds: given });
  });
}

async function openCapture(files) {
  const capture = await readCapture(files, at("encoding").value, say);
  say(`Solving ${capture.count} photographs of ${capture.width} × ${capture.height}…`);
  const begun = performance.now();
  const { normal, albedo, roughness, error } = await runInWorker(at("solver").value, capture.feeds);
  const seconds = ((performance.now() - begun) / 1000).toFixed(1);
  const brightest = albedo.data.reduce((a, b) => Math.max(a, b), 1e-9);
  const shown = brightest > 1 ? albedo.data.map((value) => value / brightest) : albedo.data;
  const degrees = (roughness.data.reduce((a, b) => Math.max(a, b), 0) * 180) / Math.PI;
  const estimated = at("solver").value === "stereo";
  if (estimated) at("roughness").value = Math.round(degrees);
  Object.assign(state, { picture: null, mesh: null });
  at("turn").disabled = true;
  label();
  surface(normal.data, capture.width, capture.height, shown);
  const found = estimated ? `roughness ${degrees.toFixed(0)}°` : "the network tells no roughness";
  const expected = (median(error.data.filter((value) => value > 0)) * 180) / Math.PI;
  say(`${capture.count} photographs solved in ${seconds} s: ${found}, normals within ${expected.toFixed(1)}°. Now relight them.`);
}

/** The middle one of the values. */
function median(values) {
  return values.toSorted()[Math.floor(values.length / 2)] ?? 0;
}

/** Opens one normal map, one mesh, or a capture. */
async function open(files) {
  try {
    const mesh = files.find((file) => /\.(obj|ply|stl)$/i.test(file.name));
    if (mesh) await openMesh(mesh);
    else if (files.length === 1 && !/\.(txt|csv|lp)$/i.test(files[0].name)) await openNormals(files[0]);
    else if (files.length) await openCapture(files);
  } catch (error) {
    fail(error);
  }
}

// --- Input --------------------------------------------------------------------------------------------------------

function moveLight(x, y) {
  const far = Math.hypot(x, y);
  const most = 0.98;
  state.light = far > most ? [(x * most) / far, (y * most) / far] : [x, y];
  refresh();
}

function listen(canvas) {
  const follow = (event) => {
    const box = canvas.getBoundingClientRect();
    moveLight(((event.clientX - box.left) / box.width) * 2 - 1, 1 - ((event.clientY - box.top) / box.height) * 2);
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    follow(event);
  });
  canvas.addEventListener("pointermove", (event) => canvas.hasPointerCapture(event.pointerId) && follow(event));
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!step) return;
    event.preventDefault();
    moveLight(state.light[0] + 0.05 * step[0], state.light[1] + 0.05 * step[1]);
  });
}

function label() {
  at("roughness-value").textContent = `${at("roughness").value}°`;
  at("albedo-value").textContent = (at("albedo").value / 100).toFixed(2);
}

async function heights() {
  const { width, height, normals } = state;
  const count = width * height;
  const mask = Uint8Array.from({ length: count }, (_, i) => normals[i] || normals[count + i] || normals[2 * count + i] ? 1 : 0);
  say("Integrating the normals…");
  const { depth } = await runInWorker("integration", {
    normal: { data: normals, dims: [3, height, width] },
    mask: { data: mask, dims: [1, height, width], type: "bool" },
  });
  return depth.data;
}

const SAVES = {
  normals: async () => {
    saveNormals(state);
    return "normal.png: 16 bits, green up.";
  },
  albedo: async () => {
    if (!state.albedo) throw new Error("Only solved photographs have an albedo.");
    saveAlbedo(state);
    return "albedo.png: 16 bits, sRGB.";
  },
  heights: async () => `height.png: from black to white ${saveHeights(state, await heights()).toFixed(1)} pixels.`,
  glb: async () => `surface.glb: ${await saveGlb(state, await heights())} triangles, in pixels.`,
};

async function save() {
  try {
    say(await SAVES[at("saved").value]());
  } catch (error) {
    fail(error);
  }
}

async function fill() {
  for (const [value, text] of Object.entries(NAMES)) {
    at("model").add(new Option(text, value, false, value === "vcavity"));
    at("other").add(new Option(text, value, false, value === "qualitative"));
  }
  at("device").add(new Option(`WASM, ${threads} thread${threads > 1 ? "s" : ""}`, "wasm"));
  if (await navigator.gpu?.requestAdapter()) at("device").add(new Option("WebGPU", "webgpu"));
}

function wire() {
  listen(at("left"));
  listen(at("right"));
  for (const id of ["roughness", "albedo", "tint", "model", "other", "device"])
    at(id).addEventListener("input", () => {
      times.left = [];
      times.right = [];
      label();
      refresh();
    });
  at("compare").addEventListener("input", () => {
    document.body.classList.toggle("alone", !at("compare").checked);
    refresh();
  });
  at("green").addEventListener("input", () => {
    if (!state.picture) return;
    try {
      surface(decodeNormals(state.picture, at("green").value), state.width, state.height);
    } catch (error) {
      fail(error);
    }
  });
  at("turn").addEventListener("change", () => drawMesh().catch(fail));
  at("files").addEventListener("change", () => open([...at("files").files]));
  at("save").addEventListener("click", save);
  document.addEventListener("dragover", (event) => {
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  document.addEventListener("dragleave", () => document.body.classList.remove("dropping"));
  document.addEventListener("drop", (event) => {
    event.preventDefault();
    document.body.classList.remove("dropping");
    open([...event.dataTransfer.files]);
  });
}

async function begin() {
  if (matchMedia("(max-width: 40rem)").matches) at("compare").checked = false;
  document.body.classList.toggle("alone", !at("compare").checked);
  wire();
  label();
  await fill();
  try {
    const answer = await fetch("graphs/normal.png");
    if (!answer.ok) throw new Error("graphs/normal.png is missing: run serve.py again.");
    const picture = new File([await answer.blob()], "normal.png");
    await openNormals(picture);
    say("Drag on a picture to move the light.");
  } catch (error) {
    fail(error);
  }
}

begin();
