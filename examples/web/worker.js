// Graphs that take long run here, so that the page stays responsive.

import { run } from "./graphs.js";

self.onmessage = async ({ data: { id, name, feeds } }) => {
  try {
    self.postMessage({ id, found: await run(name, feeds) });
  } catch (error) {
    self.postMessage({ id, error: error.message });
  }
};
