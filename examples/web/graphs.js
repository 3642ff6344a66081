// Runs the graphs, one session for each, on WASM or WebGPU; in the page and in a worker.

const RUNTIME = new URL("./node_modules/onnxruntime-web/dist/", import.meta.url).href;
const BUNDLES = { wasm: "ort.wasm.bundle.min.mjs", webgpu: "ort.webgpu.bundle.min.mjs" };

export class GraphError extends Error {}

export const threads = globalThis.crossOriginIsolated ? Math.min(navigator.hardwareConcurrency || 1, 4) : 1;

const runtimes = {};
const sessions = new Map();

async function runtime(device) {
  runtimes[device] ??= import(RUNTIME + BUNDLES[device]).then((ort) => {
    ort.env.wasm.wasmPaths = RUNTIME;
    ort.env.wasm.numThreads = threads;
    ort.env.logLevel = "error";
    return ort;
  });
  return runtimes[device];
}

async function open(name, device) {
  const address = new URL(`./graphs/${name}.onnx`, import.meta.url);
  const ort = await runtime(device);
  try {
    const answer = await fetch(address);
    if (!answer.ok) throw new Error(`${answer.status} ${answer.statusText}`);
    const session = await ort.InferenceSession.create(new Uint8Array(await answer.arrayBuffer()), {
      executionProviders: device === "wasm" ? ["wasm"] : ["webgpu", "wasm"],
      logSeverityLevel: 3,
    });
    return { ort, session };
  } catch (error) {
    sessions.delete(`${device}/${name}`);
    throw new GraphError(`graphs/${name}.onnx does not load (${error.message}). Run serve.py again to write it anew.`);
  }
}

/** Takes {name: {data, dims, type?}} and returns {name: {data, dims}}. */
export async function run(name, feeds, device = "wasm") {
  const key = `${device}/${name}`;
  if (!sessions.has(key)) sessions.set(key, open(name, device));
  const { ort, session } = await sessions.get(key);
  const tensors = Object.fromEntries(
    Object.entries(feeds).map(([k, v]) => [k, new ort.Tensor(v.type ?? "float32", v.data, v.dims)]),
  );
  const answers = await session.run(tensors);
  const found = {};
  for (const [k, tensor] of Object.entries(answers)) {
    found[k] = { data: await tensor.getData(), dims: tensor.dims };
    tensor.dispose();
  }
  return found;
}
