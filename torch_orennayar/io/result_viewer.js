// The viewer of report.html: relights the result by the formulas of torch_orennayar/reflectance/formulas.py, and turns
// its relief. Reads one JSON object from #viewer-data; see result_viewer.py for what it holds.
"use strict";
(() => {
  const data = JSON.parse(document.getElementById("viewer-data").textContent);
  const canvas = document.getElementById("viewer");
  const say = document.getElementById("viewer-says");
  canvas.width = data.width;
  canvas.height = data.height;
  const gl = canvas.getContext("webgl2", { preserveDrawingBuffer: true, antialias: true });
  if (!gl) {
    say.textContent = "This browser has no WebGL 2, which the relighting needs.";
    return;
  }

  const reflectance = {
    lambert: "return rho;",
    classic: `vec3 ab = vec3(1.0 - 0.5 * x / (x + A_CONSTANT), 0.45 * x / (x + 0.09), 0.0);
      return rho * (ab.x + ab.y * max(lv - ci * co, 0.0) / max(ci, co));`,
    fujii: `float a = 1.0 - 0.5 * x / (x + 0.33), b = 0.45 * x / (x + 0.09), s = lv - ci * co;
      vec3 bounce = 0.17 * min(rho, vec3(1.0)) * (x / (x + 0.13));
      return rho * (a + bounce + b * (min(s, 0.0) + max(s, 0.0) / max(ci, co)));`,
    full: `float a = 1.0 - 0.5 * x / (x + 0.33), b = 0.45 * x / (x + 0.09);
      float cb = max(ci, co), ca = min(ci, co);
      float sa = max(sqrt(max(1.0 - ca * ca, 0.0)), 1e-6), sb = max(sqrt(max(1.0 - cb * cb, 0.0)), 1e-6);
      float alpha = atan(sa / ca), beta = atan(sb / cb), s = lv - ci * co;
      float phi = clamp(s / (sa * sb), -1.0, 1.0), share = beta * 2.0 / PI;
      float back = min(phi, 0.0) * share * share * share * sb;
      float grazing = alpha * beta * 4.0 / (PI * PI);
      float c3 = 0.125 * x / (x + 0.09) * grazing * grazing;
      vec3 bounce = 0.17 * min(rho, vec3(1.0)) * (x / (x + 0.13)) * (1.0 - phi * share * share);
      return rho * (a + b * (s - back) / cb + (1.0 - abs(phi)) * c3 * (sa + sb) / (ci + co) + bounce);`,
    vcavity: `float y = x / (x + SHAPE[0]), yy = y * y, q = ci * co, p = ci + co, h = 1.0 + lv, s = lv - q, pp = p * p;
      vec3 b = min(rho, vec3(1.0)), l = y * (b / (1.0 - SHAPE[1] * b));
      float k = SHAPE[2] + SHAPE[3] * y + SHAPE[4] * yy, m = 1.0 - k, mq = m * q;
      float u = y / sqrt(k * (k + m * (pp - 2.0 * q)) + mq * mq);
      float r = inversesqrt(pp + (SHAPE[5] + SHAPE[6] * y) * (pp - 2.0 * h * q) + 1e-12);
      float hr = h * r, qr = q * r, pr = p * r, yp = yy * p;
      vec3 zero = qr * (L[0] * hr + L[2]) + L[1] * pr + L[3] * yp + b * (L[14] + L[15] * yy + L[16] * p);
      zero = 1.0 + y * (zero + l * (L[19] + y * (L[20] * q + L[21] * h)));
      vec3 one = vec3(hr * (L[4] + y * (L[5] + L[6] * q + L[7] * pr)) + s * (L[8] + L[9] * s + L[10] * yp));
      one += y * (L[11] + b * (r * (L[17] * qr + L[18] * h * p))) + l * (L[22] * q);
      vec3 two = L[12] + L[13] * p + l * (L[23] * s * s);
      return rho * max(zero + u * (one + u * two), vec3(0.0));`,
    eon: `float r = x / (0.2859 + 1.1110 * x), c1 = 0.5 - 2.0 / (3.0 * PI), c2 = 2.0 / 3.0 - 28.0 / (15.0 * PI);
      float a = 1.0 / (1.0 + c1 * r), s = lv - ci * co;
      float single = a * (1.0 + r * (min(s, 0.0) + max(s, 0.0) / max(ci, co))), mean = a * (1.0 + c2 * r);
      vec3 b = min(rho, vec3(1.0));
      float lost = max(c1 - lostToward(ci), 0.0) * max(c1 - lostToward(co), 0.0) * r * a / (c1 - c2);
      return rho * (single + b * mean / (1.0 - b * (1.0 - mean)) * lost);`,
  };
  const chosen = data.model.startsWith("qualitative") ? "classic" : data.model;
  const numbers = (name, values) => `const float ${name}[${values.length}] = float[](${values.map((v) => v.toFixed(9)).join(", ")});`;
  const fragment = `#version 300 es
    precision highp float;
    precision highp sampler2D;
    uniform sampler2D ${["normals", "albedos", ...data.highlights.map((_, k) => `highlights${k}`)].join(", ")};
    uniform vec3 light;
    uniform float exposure;
    in vec2 place;
    out vec4 colour;
    const float PI = 3.14159265358979;
    const float A_CONSTANT = ${data.model === "qualitative-0.57" ? "0.57" : "0.33"};
    ${numbers("SHAPE", data.shape)}
    ${numbers("L", data.linear)}
    float lostToward(float c) {
      float m = 1.0 - c;
      return m * (0.0571085289 + m * (0.491881867 + m * (-0.332181442 + m * 0.0714429953)));
    }
    vec3 reflected(float ci, float co, float lv, vec3 rho, float sigma) {
      float x = sigma * sigma;
      ${reflectance[chosen]}
    }
    float lobe(float ci, float co, float lv, float exponent) {
      float across = (ci + co) / sqrt(max(2.0 + 2.0 * lv, 1e-12));
      return ci > 0.0 && co > 0.0 ? (exponent + 8.0) / 8.0 * pow(clamp(across, 0.0, 1.0), exponent) : 0.0;
    }
    void main() {
      ivec2 at = ivec2(clamp(place * vec2(${data.width}, ${data.height}), vec2(0.0), vec2(${data.width - 1}, ${data.height - 1})));
      vec4 n = texelFetch(normals, at, 0), rho = texelFetch(albedos, at, 0);
      if (rho.a < 0.5) discard;
      float ci = dot(n.xyz, light), co = n.z;
      vec3 shade = vec3(0.0);
      if (ci > 0.0 && co > 0.0) {
        shade = reflected(ci, co, light.z, rho.rgb, n.w) * ci * ${data.falloff === 1 ? "1.0" : `pow(ci * co, ${(data.falloff - 1).toFixed(9)})`};
        ${data.exponents.map((p, k) => `shade += texelFetch(highlights${k}, at, 0).rgb * lobe(ci, co, light.z, ${p.toFixed(1)}) * ci;`).join("\n")}
      }
      vec3 seen = clamp(shade * exposure, 0.0, 1.0);
      vec3 bright = 1.055 * pow(max(seen, vec3(1e-9)), vec3(1.0 / 2.4)) - 0.055;
      colour = vec4(mix(bright, 12.92 * seen, vec3(lessThanEqual(seen, vec3(0.0031308)))), 1.0);
    }`;
  const vertex = `#version 300 es
    in vec3 corner;
    uniform mat3 turn;
    uniform vec2 fit;
    out vec2 place;
    void main() {
      place = vec2(corner.x, corner.y);
      vec3 p = turn * (vec3(corner.x - 0.5, 0.5 - corner.y, corner.z) * vec3(fit, 1.0));
      gl_Position = vec4(p.xy / fit * 2.0, -0.5 * p.z, 1.0);
    }`;

  const compile = (kind, text) => {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    return shader;
  };
  const program = gl.createProgram();
  gl.attachShader(program, compile(gl.VERTEX_SHADER, vertex));
  gl.attachShader(program, compile(gl.FRAGMENT_SHADER, fragment));
  gl.bindAttribLocation(program, 0, "corner");
  gl.linkProgram(program);
  gl.useProgram(program);

  const decode = (text) => Uint8Array.from(atob(text), (c) => c.charCodeAt(0)).buffer;
  const textures = [["normals", data.normals], ["albedos", data.albedos]];
  data.highlights.forEach((map, k) => textures.push([`highlights${k}`, map]));
  textures.forEach(([name, map], unit) => {
    const stored = new Int16Array(decode(map.values));
    const values = Float32Array.from(stored, (v, i) => (v / 32767) * map.scale[i % 4]);
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA32F, data.width, data.height, 0, gl.RGBA, gl.FLOAT, values);
    for (const filter of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, filter, gl.NEAREST);
    const where = gl.getUniformLocation(program, name);
    if (where) gl.uniform1i(where, unit);
  });

  // The flat picture as two triangles, and the relief as a grid of them.
  const upload = (corners, faces) => {
    const state = gl.createVertexArray();
    gl.bindVertexArray(state);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, new Float32Array(corners), gl.STATIC_DRAW);
    gl.enableVertexAttribArray(0);
    gl.vertexAttribPointer(0, 3, gl.FLOAT, false, 0, 0);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, new Uint32Array(faces), gl.STATIC_DRAW);
    return { state, count: faces.length };
  };
  const flat = upload([0, 0, 0, 1, 0, 0, 0, 1, 0, 1, 1, 0], [0, 2, 1, 1, 2, 3]);
  const heights = new Int16Array(decode(data.heights.values));
  const [rows, columns] = data.heights.size;
  const corners = [], faces = [];
  for (let i = 0; i < rows * columns; i++) {
    const x = ((i % columns) + 0.5) / columns, y = (Math.floor(i / columns) + 0.5) / rows;
    corners.push(x, y, (heights[i] / 32767) * data.heights.scale);
  }
  const outside = (i) => heights[i] === -32768;
  for (let i = 0; i < rows - 1; i++) {
    for (let j = 0; j < columns - 1; j++) {
      const a = i * columns + j, quad = [a, a + columns, a + 1, a + columns + 1];
      if (!quad.some(outside)) faces.push(quad[0], quad[1], quad[2], quad[2], quad[1], quad[3]);
    }
  }
  const relief = upload(corners, faces);

  const state = { light: [0.4, 0.4, 0.825], azimuth: 0, elevation: 0, turning: false };
  const uniform = (name) => gl.getUniformLocation(program, name);
  const longest = Math.max(data.width, data.height);
  gl.uniform2f(uniform("fit"), data.width / longest, data.height / longest);
  gl.uniform1f(uniform("exposure"), data.exposure);
  gl.enable(gl.DEPTH_TEST);
  const draw = () => {
    const [x, y, z] = state.light, length = Math.hypot(x, y, z);
    gl.uniform3f(uniform("light"), x / length, y / length, z / length);
    const [a, e] = state.turning ? [state.azimuth, state.elevation] : [0, 0];
    const [ca, sa, ce, se] = [Math.cos(a), Math.sin(a), Math.cos(e), Math.sin(e)];
    gl.uniformMatrix3fv(uniform("turn"), false, [ca, sa * se, -sa * ce, 0, ce, se, sa, -ca * se, ca * ce]);
    gl.viewport(0, 0, canvas.width, canvas.height);
    gl.clearColor(1, 1, 1, 1);
    gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
    const shape = state.turning ? relief : flat;
    gl.bindVertexArray(shape.state);
    gl.drawElements(gl.TRIANGLES, shape.count, gl.UNSIGNED_INT, 0);
    const zenith = Math.round((Math.acos(z / length) * 180) / Math.PI), from = Math.round((Math.atan2(y, x) * 180) / Math.PI);
    say.textContent = `Light ${zenith}° off the view, from ${from}° (0° right, 90° up).`;
  };
  const aim = (x, y) => {
    const radius = Math.min(Math.hypot(x, y), 0.98), angle = Math.atan2(y, x);
    state.light = [radius * Math.cos(angle), radius * Math.sin(angle), Math.sqrt(1 - radius * radius)];
    draw();
  };
  let last = null;
  const drag = (event) => {
    if (last === null) return;
    const box = canvas.getBoundingClientRect();
    if (state.turning) {
      state.azimuth += ((event.clientX - last[0]) / box.width) * 3;
      state.elevation = Math.max(-1.4, Math.min(1.4, state.elevation + ((event.clientY - last[1]) / box.height) * 3));
      last = [event.clientX, event.clientY];
      draw();
    } else {
      const half = Math.min(box.width, box.height) / 2;
      aim((event.clientX - box.left - box.width / 2) / half, (box.top + box.height / 2 - event.clientY) / half);
    }
  };
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    last = [event.clientX, event.clientY];
    drag(event);
  });
  canvas.addEventListener("pointermove", drag);
  for (const name of ["pointerup", "pointercancel"]) canvas.addEventListener(name, () => (last = null));
  canvas.addEventListener("keydown", (event) => {
    const step = { ArrowLeft: [-0.1, 0], ArrowRight: [0.1, 0], ArrowUp: [0, 0.1], ArrowDown: [0, -0.1] }[event.key];
    if (!step) return;
    event.preventDefault();
    if (state.turning) {
      state.azimuth += step[0];
      state.elevation -= step[1];
      draw();
    } else aim(state.light[0] + step[0], state.light[1] + step[1]);
  });
  for (const choice of document.querySelectorAll("input[name=viewer-mode]")) {
    choice.addEventListener("change", () => {
      state.turning = choice.value === "turn";
      draw();
    });
  }
  draw();
  window.viewer = { state, draw };
})();
