"use strict";
// An orbit camera, a light that one drags, a timeline. All data lie in the page; no library, no request.
const scene = JSON.parse(document.getElementById("scene").textContent);
const $ = (id) => document.getElementById(id);
const canvas = $("canvas");
const gl = canvas.getContext("webgl2", { antialias: true, preserveDrawingBuffer: true });

async function bytes(text) {  // base64 of a zlib stream
  const stream = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}
async function positions(text) {  // 16-bit steps of the box that all frames share
  const q = new Uint16Array(await bytes(text)), p = new Float32Array(q.length);
  for (let i = 0; i < q.length; i++) p[i] = (q[i] / 65535 - 0.5) * scene.size[i % 3];
  return p;
}
const coordinates = async (text) => Float32Array.from(new Uint16Array(await bytes(text)), (q) => q / 65535);
async function list(text) {  // faces as differences, which pack well
  const faces = new Int32Array(await bytes(text));
  for (let i = 3; i < faces.length; i++) faces[i] += faces[i - 3];
  return new Uint32Array(faces.buffer);
}

function vertexNormals(p, faces) {
  const n = new Float32Array(p.length);
  for (let f = 0; f < faces.length; f += 3) {
    const a = 3 * faces[f], b = 3 * faces[f + 1], c = 3 * faces[f + 2];
    const ux = p[b] - p[a], uy = p[b + 1] - p[a + 1], uz = p[b + 2] - p[a + 2];
    const vx = p[c] - p[a], vy = p[c + 1] - p[a + 1], vz = p[c + 2] - p[a + 2];
    const x = uy * vz - uz * vy, y = uz * vx - ux * vz, z = ux * vy - uy * vx;
    for (const v of [a, b, c]) { n[v] += x; n[v + 1] += y; n[v + 2] += z; }
  }
  return n;  // the shader gives them unit length
}
function edgesOf(faces) {
  const edges = new Uint32Array(2 * faces.length);
  for (let f = 0, e = 0; f < faces.length; f += 3)
    for (let k = 0; k < 3; k++) { edges[e++] = faces[f + k]; edges[e++] = faces[f + (k + 1) % 3]; }
  return edges;
}

const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec2 uv;
uniform mat4 clip; out vec3 vNormal; out vec2 vUv;
void main() { vNormal = normal; vUv = uv; gl_Position = clip * vec4(position, 1.0); }`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 vNormal; in vec2 vUv; out vec4 colour;
uniform sampler2D captured, normals; uniform vec3 light; uniform int look; uniform bool measured;
void main() {
  if (look == 9) { colour = vec4(0.35, 0.62, 1.0, 0.4); return; }  // wires
  vec3 n = normalize(vNormal) * (gl_FrontFacing ? 1.0 : -1.0);
  if (measured) { vec3 m = texture(normals, vUv).rgb * 2.0 - 1.0; if (length(m) > 0.5) n = normalize(m); }
  float lit = 0.06 + 0.94 * max(dot(n, light), 0.0);
  vec3 linear = vec3(0.78 * lit);
  if (look == 3) {
    vec2 cell = floor(vUv * vec2(32.0, 24.0));
    linear = (mod(cell.x + cell.y, 2.0) < 0.5 ? vec3(0.85, 0.82, 0.78) : vec3(0.62, 0.13, 0.08)) * lit;
  }
  vec3 shown = pow(linear, vec3(1.0 / 2.2));
  if (look == 0) shown = texture(captured, vUv).rgb;
  if (look == 2) shown = n * 0.5 + 0.5;
  colour = vec4(shown, 1.0);
}`;

let program, buffers, at = {}, turn, light = [-0.35, 0.45, 0.82], shownFrame = 0, playing = 0, counts = {}, drawing = 0;
const FOCAL = 2.4, FILLED = 0.86;
function focals() {
  const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight);
  return aspect >= 1 ? [FOCAL / aspect, FOCAL] : [FOCAL, FOCAL * aspect];
}
function home() {  // all frames fill the view
  const [px, py] = focals(), [x, y, z] = scene.size;
  return { azimuth: 0, elevation: 0, distance: Math.max(px * x, py * y) / (2 * FILLED) + z / 2, x: 0, y: 0 };
}

function start() {
  program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
    gl.attachShader(program, shader);
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  for (const name of ["clip", "light", "look", "measured", "captured", "normals"]) at[name] = gl.getUniformLocation(program, name);
  buffers = { faces: gl.createBuffer(), edges: gl.createBuffer() };
  for (const [name, width] of [["position", 3], ["normal", 3], ["uv", 2]]) {
    buffers[name] = gl.createBuffer();
    const place = gl.getAttribLocation(program, name);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.enableVertexAttribArray(place);
    gl.vertexAttribPointer(place, width, gl.FLOAT, false, 0, 0);
  }
  buffers.captured = texture(0);
  buffers.normals = texture(1);
  gl.uniform1i(at.captured, 0);
  gl.uniform1i(at.normals, 1);
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.POLYGON_OFFSET_FILL);
  gl.polygonOffset(2, 2);
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
}
function texture(unit) {
  const made = gl.createTexture();
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.bindTexture(gl.TEXTURE_2D, made);
  for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
  for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.LINEAR);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, 1, 1, 0, gl.RGB, gl.UNSIGNED_BYTE, new Uint8Array([128, 128, 255]));
  return made;
}
const pictures = new Map();
function picture(uri) {
  if (!pictures.has(uri)) {
    const image = new Image();
    image.src = uri;
    pictures.set(uri, image.decode().then(() => image));
    if (pictures.size > 64) pictures.delete(pictures.keys().next().value);
  }
  return pictures.get(uri);
}
function upload(unit, image) {
  gl.activeTexture(gl.TEXTURE0 + unit);
  gl.pixelStorei(gl.UNPACK_FLIP_Y_WEBGL, true);
  gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGB, gl.RGB, gl.UNSIGNED_BYTE, image);
}
function load(target, buffer, values) {
  gl.bindBuffer(target, buffers[buffer]);
  gl.bufferData(target, values, gl.DYNAMIC_DRAW);
}

const registered = () => $("surface").value === "registered";
let topology = null;
async function show(index) {
  shownFrame = index;
  if (gl && !await loadSurface(index)) return;  // moved on meanwhile
  const frame = scene.frames[index];
  $("time").value = index;
  $("number").textContent = `frame ${frame.number}`;
  for (const image of document.querySelectorAll("aside img")) {
    const uri = frame.pictures[image.dataset.name];
    image.style.visibility = uri ? "visible" : "hidden";
    if (uri) image.src = uri;
  }
  if (gl) draw();
  document.body.dataset.shown = String(index);  // what tests wait for
}
async function loadSurface(index) {
  const frame = scene.frames[index], source = registered() ? scene.registered : frame.own;
  if (!source) {  // a frame without depth, among others that have it
    counts = {}; topology = null;
    return true;
  }
  const images = registered() ? scene.frames[scene.registered.template].pictures : frame.pictures;
  const wanted = await Promise.all([images.captured, images.normals].map((uri) => uri && picture(uri)));
  const p = await positions(registered() ? scene.registered.frames[index] : source.positions);
  const [faces, uv] = await Promise.all([list(source.faces), coordinates(source.uv)]);
  if (shownFrame !== index || (source === scene.registered) !== registered()) return false;
  wanted.forEach((image, unit) => image && upload(unit, image));
  if (topology !== source) {
    load(gl.ELEMENT_ARRAY_BUFFER, "edges", edgesOf(faces));
    load(gl.ELEMENT_ARRAY_BUFFER, "faces", faces);
    load(gl.ARRAY_BUFFER, "uv", uv);
    counts = { faces: faces.length, edges: 2 * faces.length };
    topology = source;
  }
  load(gl.ARRAY_BUFFER, "position", p);
  load(gl.ARRAY_BUFFER, "normal", vertexNormals(p, faces));
  return true;
}

function clipMatrix() {
  const { azimuth, elevation, distance, x, y } = turn;
  const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(elevation), Math.sin(elevation)];
  // camera from world: turn about y, then about x, then step back
  const r = [ca, 0, -sa, -sa * se, ce, -ca * se, sa * ce, se, ca * ce];
  const [px, py] = focals(), near = 0.02, far = 20;
  const a = (far + near) / (near - far), b = (2 * far * near) / (near - far);
  const t = [-x, -y, -distance];
  const m = new Float32Array(16);
  for (let column = 0; column < 3; column++) {
    m[4 * column] = px * r[column];
    m[4 * column + 1] = py * r[3 + column];
    m[4 * column + 2] = a * r[6 + column];
    m[4 * column + 3] = -r[6 + column];
  }
  m.set([px * t[0], py * t[1], a * t[2] + b, -t[2]], 12);
  return m;
}
function draw() {
  if (!drawing) drawing = requestAnimationFrame(paint);
}
function paint() {
  drawing = 0;
  const ratio = window.devicePixelRatio || 1;
  const width = Math.round(canvas.clientWidth * ratio), height = Math.round(canvas.clientHeight * ratio);
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  gl.viewport(0, 0, width, height);
  gl.clearColor(0.125, 0.149, 0.184, 1);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  gl.uniformMatrix4fv(at.clip, false, clipMatrix());
  gl.uniform3fv(at.light, light);
  gl.uniform1i(at.measured, !registered() && scene.hasNormals ? 1 : 0);
  gl.uniform1i(at.look, Number($("look").value));
  if (counts.faces) {
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.faces);
    gl.drawElements(gl.TRIANGLES, counts.faces, gl.UNSIGNED_INT, 0);
    if ($("wire").checked) {
      gl.uniform1i(at.look, 9);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.edges);
      gl.drawElements(gl.LINES, counts.edges, gl.UNSIGNED_INT, 0);
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    }
  }
  paintLight();
}
function paintLight() {
  const disc = $("light").getContext("2d"), r = 100, c = 110;
  disc.clearRect(0, 0, 220, 220);
  const glow = disc.createRadialGradient(c + light[0] * r, c - light[1] * r, 4, c, c, r * 1.25);
  glow.addColorStop(0, "#f3f0e4");
  glow.addColorStop(1, "#39424f");
  disc.fillStyle = glow;
  disc.beginPath(); disc.arc(c, c, r, 0, 7); disc.fill();
  disc.fillStyle = "#ffb300"; disc.strokeStyle = "#161b22"; disc.lineWidth = 3;
  disc.beginPath(); disc.arc(c + light[0] * r, c - light[1] * r, 11, 0, 7); disc.fill(); disc.stroke();
}

function dragged(element, move) {
  element.addEventListener("pointerdown", (down) => { element.setPointerCapture(down.pointerId); move(down, true); });
  element.addEventListener("pointermove", (event) => { if (event.buttons) { move(event, false); draw(); } });
}
function connect() {
  dragged($("light"), (event) => {
    const box = $("light").getBoundingClientRect();
    let x = (event.clientX - box.left) / box.width * 2.2 - 1.1, y = 1.1 - (event.clientY - box.top) / box.height * 2.2;
    const far = Math.hypot(x, y);
    if (far > 0.99) { x *= 0.99 / far; y *= 0.99 / far; }
    light = [x, y, Math.sqrt(1 - x * x - y * y)];
    draw();
  });
  dragged(canvas, (event, first) => {
    if (first) return;
    if (event.shiftKey) {
      turn.x -= event.movementX * turn.distance / 900;
      turn.y += event.movementY * turn.distance / 900;
    } else {
      turn.azimuth += event.movementX * 0.008;
      turn.elevation = Math.max(-1.55, Math.min(1.55, turn.elevation + event.movementY * 0.008));
    }
  });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    turn.distance = Math.max(0.3, Math.min(12, turn.distance * Math.exp(event.deltaY * 0.001)));
    draw();
  }, { passive: false });
  for (const id of ["look", "wire"]) $(id).addEventListener("change", draw);
  $("surface").addEventListener("change", () => show(shownFrame));
  $("reset").addEventListener("click", () => { turn = home(); draw(); });
  window.addEventListener("resize", draw);
}
function stop() { playing = 0; $("play").textContent = "play"; }
async function play() {  // a frame is shown before the next is asked for, however long that takes
  const run = playing = performance.now();
  $("play").textContent = "pause";
  while (playing === run) {
    const due = performance.now() + 1000 / Math.min(scene.rate, 30);
    await show((shownFrame + 1) % scene.frames.length);
    await new Promise((done) => setTimeout(done, Math.max(0, due - performance.now())));
  }
}

const CAPTIONS = { depth: "depth, as relief", shadows: "lights that arrive: white all, dark none" };
function main() {
  const names = new Set(scene.frames.flatMap((frame) => Object.keys(frame.pictures)));
  for (const name of names) {
    const figure = document.createElement("figure"), image = new Image(), caption = document.createElement("figcaption");
    image.dataset.name = name;
    image.alt = name;
    caption.textContent = CAPTIONS[name] || name;
    figure.append(caption, image);
    $("pictures").append(figure);
  }
  $("time").max = scene.frames.length - 1;
  $("time").disabled = $("play").disabled = scene.frames.length === 1;
  $("time").addEventListener("input", () => { stop(); show(Number($("time").value)); });
  $("play").addEventListener("click", () => (playing ? stop() : play()));
  if (gl) {
    turn = home();
    if (scene.frames.some((frame) => frame.own)) $("surface").add(new Option("of each frame", "own"));
    if (scene.registered) $("surface").add(new Option("registered", "registered"));
    if (!names.has("captured")) $("look").querySelector("[value='0']").remove();
    start();
    connect();
  } else {
    for (const id of ["surface", "look", "wire", "reset"]) $(id).disabled = true;
    $("view").innerHTML = '<p id="failed">This browser shows no WebGL 2; the pictures work all the same.</p>';
  }
  show(0);
}
main();
