"use strict";
// Asks for one surface, draws it, and asks again. What drawing takes decides how large and how often: a browser
// without a graphics card shares its processors with the capture, which comes first.
const $ = (id) => document.getElementById(id);
const LEVELS = [  // longest sides in pixels; scale: of the drawn picture to the window's
  { grid: 160, normals: 640, camera: 480, scale: 2 },
  { grid: 160, normals: 640, camera: 480, scale: 1 },
  { grid: 80, normals: 320, camera: 320, scale: 0.6 },
  { grid: 64, normals: 240, camera: 240, scale: 0.4 },
];
const SLOW_MS = 12, FAST_MS = 6, SHARE = 0.1;  // of a drawing; of the time that drawing may take
const REDUCED = 2, MOST_HZ = [30, 30, 10, 10], LEAST_HZ = 4, PATIENCE_MS = 10000;
const SWING = Math.PI / 6, SWING_S = 6, FOCAL = 2.4, FILLED = 0.86;
const id = Math.random().toString(36).slice(2);
const canvas = $("surface");
const gl = canvas.getContext("webgl2", { antialias: false, alpha: false, depth: true });
const view = { azimuth: 0, elevation: 0, zoom: 1, light: [-0.42, 0.42, 0.8] };

const VERTEX = `#version 300 es
precision highp float; precision highp int;
uniform highp usampler2D depth; uniform ivec2 grid; uniform vec2 focal, centre, steps; uniform bool perspective;
uniform vec3 middle; uniform mat4 clip; out vec2 vUv;
void main() {
  ivec2 at = ivec2(gl_VertexID % grid.x, gl_VertexID / grid.x);
  float z = steps.x + steps.y * float(texelFetch(depth, at, 0).r);
  vec2 xy = (vec2(at) - centre) / focal * (perspective ? z : 1.0);
  vUv = (vec2(at) + 0.5) / vec2(grid);
  gl_Position = clip * vec4(vec3(xy.x, -xy.y, -z) - middle, 1.0);
}`;
const FRAGMENT = `#version 300 es
precision mediump float;
in vec2 vUv; out vec4 colour;
uniform sampler2D normals; uniform mat3 turned; uniform vec3 light;
void main() {
  vec4 known = texture(normals, vUv);  // all 0 where there is none
  vec3 n = normalize(turned * (known.rgb / max(known.a, 0.01) * 2.0 - 1.0)) * (gl_FrontFacing ? 1.0 : -1.0);
  float lit = 0.05 + 0.75 * max(dot(n, light), 0.0);
  colour = vec4(sqrt(lit * vec3(1.0, 0.96, 0.91)), 1.0);
}`;

let finest = 0, at = {}, indices, textures, shown = null, place = null, count = 0;
function start() {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  if (!gl.getProgramParameter(program, gl.LINK_STATUS)) throw new Error(gl.getProgramInfoLog(program));
  gl.useProgram(program);
  for (const name of ["depth", "grid", "focal", "centre", "steps", "perspective", "middle", "clip", "normals", "turned", "light"])
    at[name] = gl.getUniformLocation(program, name);
  gl.uniform1i(at.depth, 0);
  gl.uniform1i(at.normals, 1);
  textures = [texture(0, gl.NEAREST), texture(1, gl.LINEAR)];
  const facts = gl.getExtension("WEBGL_debug_renderer_info");
  const renderer = facts ? gl.getParameter(facts.UNMASKED_RENDERER_WEBGL) : "";
  if (/swiftshader|llvmpipe|softpipe|software|basic render/i.test(renderer)) finest = REDUCED;  // no graphics card
  indices = gl.createBuffer();
  gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, indices);
  gl.enable(gl.DEPTH_TEST);
  gl.clearColor(0.125, 0.149, 0.184, 1);
  canvas.addEventListener("webglcontextlost", () => setTimeout(() => location.reload(), 1000));
}
function texture(unit, filter) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
  for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, filter);
  return made;
}

function parsed(buffer) {  // see live_packet.py
  const length = new DataView(buffer).getUint32(0, true);
  const header = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  let place = 4 + length;
  if (header.depth) {
    const [rows, columns] = header.depth.shape, size = rows * columns;
    header.depth.steps = new Uint16Array(buffer, place, size);
    place += 2 * (size + (size % 2));
  }
  for (const name of ["normals", "camera"]) {
    if (!header[name]) continue;
    const [height, width] = header[name];
    header[name] = { width, height, rgba: new Uint8ClampedArray(buffer, place, 4 * width * height) };
    place += 4 * width * height;
  }
  return header;
}
function triangles({ shape: [rows, columns], steps, jump }) {  // of three pixels with depth, and no jump between
  const faces = new Uint16Array(6 * (rows - 1) * (columns - 1));
  let n = 0;
  const join = (i, j, k) => {
    const a = steps[i], b = steps[j], c = steps[k];
    const high = Math.max(a, b, c);
    if (high < 65535 && high - Math.min(a, b, c) <= jump) { faces[n++] = i; faces[n++] = j; faces[n++] = k; }
  };
  for (let v = 0; v + 1 < rows; v++)
    for (let i = v * columns; i + 1 < (v + 1) * columns; i++) {
      join(i, i + columns, i + 1);
      join(i + 1, i + columns, i + columns + 1);
    }
  return faces.subarray(0, n);
}
function load(surface) {
  const { depth, normals } = surface, [rows, columns] = depth.shape, faces = triangles(depth);
  count = faces.length;
  gl.bufferData(gl.ELEMENT_ARRAY_BUFFER, faces, gl.STREAM_DRAW);
  gl.pixelStorei(gl.UNPACK_ALIGNMENT, 2);
  gl.activeTexture(gl.TEXTURE0);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.R16UI, columns, rows, 0, gl.RED_INTEGER, gl.UNSIGNED_SHORT, depth.steps);
  gl.activeTexture(gl.TEXTURE1);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, normals.width, normals.height, 0, gl.RGBA, gl.UNSIGNED_BYTE,
    new Uint8Array(normals.rgba.buffer, normals.rgba.byteOffset, normals.rgba.length));
  gl.uniform2i(at.grid, columns, rows);
  gl.uniform2fv(at.focal, depth.focal);
  gl.uniform2fv(at.centre, depth.centre);
  gl.uniform2f(at.steps, depth.low, depth.step);
  gl.uniform1i(at.perspective, depth.perspective);
  gl.uniform3fv(at.middle, surface.place.centre);
  place = surface.place;
}
function picture(target, { width, height, rgba }) {
  if (target.width !== width || target.height !== height) [target.width, target.height] = [width, height];
  target.getContext("2d").putImageData(new ImageData(rgba, width, height), 0, 0);
}

function matrices() {
  const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight), [x, y, z] = place.size;
  const [px, py] = aspect >= 1 ? [FOCAL / aspect, FOCAL] : [FOCAL, FOCAL * aspect];
  const far = (Math.max(px * x, py * y) / (2 * FILLED) + x / 4 + z / 2) / view.zoom, reach = Math.hypot(x, y, z);
  const azimuth = view.azimuth + SWING * Math.sin((2 * Math.PI * performance.now()) / 1000 / SWING_S);
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(view.elevation), Math.sin(view.elevation)];
  const turned = [ca, sa * se, -sa * ce, 0, ce, se, sa, -ca * se, ca * ce];  // about y, then about x; by columns
  const near = Math.max(far - 2 * reach, 0.01 * far), last = far + 2 * reach;
  const a = (last + near) / (near - last), b = (2 * last * near) / (near - last), clip = new Float32Array(16);
  for (let k = 0; k < 3; k++) clip.set([px * turned[3 * k], py * turned[3 * k + 1], a * turned[3 * k + 2], -turned[3 * k + 2]], 4 * k);
  clip.set([0, 0, b - a * far, far], 12);
  return { clip, turned };
}
function draw() {
  const scale = LEVELS[level].scale * (level < REDUCED ? window.devicePixelRatio || 1 : 1);
  const width = Math.round(canvas.clientWidth * scale), height = Math.round(canvas.clientHeight * scale);
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  gl.viewport(0, 0, width, height);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  if (count && place) {
    const { clip, turned } = matrices();
    gl.uniformMatrix4fv(at.clip, false, clip);
    gl.uniformMatrix3fv(at.turned, false, turned);
    gl.uniform3fv(at.light, view.light);
    gl.drawElements(gl.TRIANGLES, count, gl.UNSIGNED_SHORT, 0);
  }
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // wait, to know what it takes
}

let level = REDUCED, usual = null, seen = 0, settled = [0, 0, 0, 0], patience = PATIENCE_MS, started = 0;
const now = () => performance.now();
const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
const nextFrame = () => new Promise(requestAnimationFrame);
const period = () => Math.min(1000 / LEAST_HZ, Math.max(1000 / MOST_HZ[level], (usual || 0) / SHARE));
function judge(cost) {  // coarser at once, finer with patience, which grows where finer was too slow
  if (++seen < 3) return;  // compiles, makes room
  usual = usual === null ? cost : 0.8 * usual + 0.2 * cost;
  if (seen < 8) return;
  if (usual > SLOW_MS && level + 1 < LEVELS.length) {
    settled[level] = now() + patience;
    patience = Math.min(2 * patience, 30 * PATIENCE_MS);
    change(level + 1);
  } else if (usual < FAST_MS && level > finest && now() > settled[level - 1]) change(level - 1);
  $("reduced").hidden = level < REDUCED;
  $("reduced").textContent = "drawing reduced: this browser draws slowly";
}
function change(to) { level = to; usual = null; seen = 0; }

let busy = false, again = false;
async function paint(packet, transfer_ms) {  // one at a time; what comes meanwhile is drawn next
  busy = true;
  started = now();
  if (gl && packet && packet.depth) load(packet);
  if (gl) draw();
  if (packet) for (const name of ["camera", "normals"]) if (packet[name]) picture($(name), packet[name]);
  const drawn = now();
  await nextFrame();
  const stalled = Math.max(0, now() - drawn - 34);  // the window's next picture takes 17 ms where nothing waits
  if (packet) judge(drawn - started + transfer_ms + stalled);
  busy = false;
  return now();
}
let timer = 0;
function turnedByHand() {  // draw soon, but no more often than the budget allows
  if (!timer) timer = setTimeout(() => { timer = 0; if (busy) turnedByHand(); else paint(null, 0); }, Math.max(0, started + period() - now()));
}

function trouble(text) {
  $("failed").textContent = text;
  $("failed").hidden = !text;
}
const flat = gl ? "" : "This browser shows no WebGL 2; the pictures beside work all the same.";
function tell(packet) {
  if (packet.status) $("status").innerHTML = packet.status;
  if ($("record") && packet.record) $("record").textContent = packet.record;
}
async function next(serial, ago_ms) {
  const { grid, normals, camera } = LEVELS[level];
  const asked = new URLSearchParams({ id, serial, ago_ms: Math.round(ago_ms), grid, normals, camera });
  const reply = await fetch(`packet?${asked}`, { cache: "no-store" });
  if (!reply.ok) throw new Error(reply.statusText);
  const come = now(), buffer = await reply.arrayBuffer();
  return [buffer.byteLength ? parsed(buffer) : null, now() - come];
}
async function watch() {
  let serial = 0, drawn = now();
  for (;;) {
    if (document.hidden) { await new Promise((done) => document.addEventListener("visibilitychange", done, { once: true })); continue; }
    let packet, transfer_ms;
    try {
      [packet, transfer_ms] = await next(serial, now() - drawn);
      trouble(flat);
    } catch (problem) {
      trouble("no connection: the capture has ended, or its machine cannot be reached");
      await sleep(3000);
      continue;
    }
    if (!packet) continue;
    while (busy) await nextFrame();
    tell(packet);
    drawn = await paint(packet, transfer_ms);
    serial = packet.serial;
    document.body.dataset.shown = String(serial);  // what tests wait for
    await sleep(Math.max(0, started + period() - now()));
  }
}
function connect() {
  canvas.addEventListener("pointerdown", (event) => canvas.setPointerCapture(event.pointerId));
  canvas.addEventListener("pointermove", (event) => {
    if (!event.buttons) return;
    if (event.shiftKey) {
      const box = canvas.getBoundingClientRect();
      let x = (2 * (event.clientX - box.left)) / box.width - 1, y = 1 - (2 * (event.clientY - box.top)) / box.height;
      const far = Math.max(1, Math.hypot(x, y) / 0.98);
      [x, y] = [x / far, y / far];
      view.light = [x, y, Math.sqrt(1 - x * x - y * y)];
    } else {
      view.azimuth += event.movementX * 0.008;
      view.elevation = Math.max(-1.55, Math.min(1.55, view.elevation + event.movementY * 0.008));
    }
    turnedByHand();
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    view.zoom = Math.max(0.2, Math.min(12, view.zoom * Math.exp(-event.deltaY * 0.001)));
    turnedByHand();
  }, { passive: false });
  const record = () => fetch("record", { method: "POST", headers: { "X-Live": "1" } }).catch(() => {});  // `watch` tells
  if ($("record")) {
    $("record").addEventListener("click", (event) => { record(); event.target.blur(); });
    window.addEventListener("keydown", (event) => { if (event.key === "r" && !event.repeat && !event.ctrlKey && !event.metaKey) record(); });
  }
}
function warmUp() {  // what compiles at the first drawing does so before the first frame comes
  const rgba = new Uint8ClampedArray(16), normals = { width: 2, height: 2, rgba };
  const depth = { shape: [2, 2], steps: new Uint16Array(4), low: 0, step: 1, focal: [1, 1], centre: [0.5, 0.5], perspective: false, jump: 1 };
  for (const name of ["camera", "normals"]) picture($(name), normals);
  load({ depth, normals, place: { centre: [0, 0, 0], size: [1, 1, 1] } });
  draw();
  count = 0;
  draw();
}

if (gl) { start(); warmUp(); }
trouble(flat);
connect();
watch();
