// Copies what the page needs to dist/, which any static host serves: node build.js, or npm run build.
// Hosts that do not send the headers of serve.py give the page one thread instead of several.

import { cpSync, existsSync, mkdirSync, rmSync, writeFileSync } from "node:fs";

const PAGE = ["index.html", "style.css", "app.js", "captures.js", "graphs.js", "meshes.js", "pictures.js", "saves.js",
  "worker.js", "graphs"];
const MODULES = ["fast-png/lib", "iobuffer/lib", "fflate/esm/browser.js", "three/build/three.module.js",
  "three/build/three.core.js", "three/examples/jsm/exporters/GLTFExporter.js", "three/examples/jsm/loaders",
  "three/examples/jsm/utils", "onnxruntime-web/dist/ort.wasm.bundle.min.mjs",
  "onnxruntime-web/dist/ort.webgpu.bundle.min.mjs", "onnxruntime-web/dist/ort-wasm-simd-threaded.mjs",
  "onnxruntime-web/dist/ort-wasm-simd-threaded.wasm", "onnxruntime-web/dist/ort-wasm-simd-threaded.asyncify.mjs",
  "onnxruntime-web/dist/ort-wasm-simd-threaded.asyncify.wasm"];
const target = new URL("./dist/", import.meta.url);

if (!existsSync(new URL("./graphs/normal.png", import.meta.url))) {
  console.error("graphs/ is missing: run python3 serve.py --prepare first");
  process.exit(1);
}
rmSync(target, { recursive: true, force: true });
mkdirSync(target);
for (const name of [...PAGE, ...MODULES.map((name) => `node_modules/${name}`)])
  cpSync(new URL(name, import.meta.url), new URL(name, target), { recursive: true });
writeFileSync(new URL(".nojekyll", target), ""); // GitHub Pages would leave node_modules out
console.log(`dist/: copy it to a static host`);
