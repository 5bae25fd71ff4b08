"use strict";
// The 3-D page of `view`, `view --html` and `live`. No library, no request beyond its own server; a page written by
// --html makes none at all. What drawing takes decides how fine it draws: a browser without a graphics card shares its
// processors with the capture, which comes first.
const setup = JSON.parse(document.getElementById("setup").textContent);
const $ = (id) => document.getElementById(id);
const live = setup.mode === "live", canvas = $("canvas");
const gl = canvas.getContext("webgl2", { antialias: true, alpha: false });

// From fine to coarse. grid, normals, camera: longest sides in pixels of what is asked for. scale: of the drawing to its window.
const LEVELS = {
  live: [
    { grid: 160, normals: 640, camera: 480, scale: 2 },
    { grid: 160, normals: 640, camera: 480, scale: 1 },
    { grid: 80, normals: 320, camera: 320, scale: 0.6 },
    { grid: 64, normals: 240, camera: 240, scale: 0.4 },
  ],
  view: [{ grid: 8192, scale: 1 }, { grid: 640, scale: 1 }, { grid: 320, scale: 0.7 }, { grid: 160, scale: 0.5 }],
  file: [{ scale: 1 }, { scale: 1 }, { scale: 0.7 }, { scale: 0.5 }],
}[setup.mode];
const REDUCED = 2, PATIENCE_MS = 10000;
// slow, fast: milliseconds of a drawing. share: of the time that drawing may take. most, least: drawings a second.
const PACE = live
  ? { slow: 12, fast: 6, share: 0.1, most: [30, 30, 10, 10], least: 4 }
  : { slow: 120, fast: 20, share: 1, most: [60, 60, 60, 60], least: 2 };
const FOCAL = 2.4, FILLED = 0.86, SWING = Math.PI / 6, SWING_S = 6, NONE = 65535, WIRE_NODES = 3000;
const now = () => performance.now();
const sleep = (ms) => new Promise((done) => setTimeout(done, ms));
const nextFrame = () => new Promise(requestAnimationFrame);

// ---- packets: see scene.py ----
function parsed(buffer) {
  const length = new DataView(buffer).getUint32(0, true);
  const packet = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  packet.block = (at, Kind, count) => new Kind(buffer, 4 + length + at, count);
  return packet;
}
async function unfolded(text) {  // base64 of a zlib stream
  const stream = new Blob([Uint8Array.from(atob(text), (c) => c.charCodeAt(0))]).stream();
  return new Response(stream.pipeThrough(new DecompressionStream("deflate"))).arrayBuffer();
}
async function withImages(packet) {
  const made = Object.entries(packet.pictures).map(async ([name, { at, bytes, type, shape }]) => {
    if (!type) return [name, new ImageData(packet.block(at, Uint8ClampedArray, 4 * shape[0] * shape[1]), shape[1], shape[0])];
    const content = new Blob([packet.block(at, Uint8Array, bytes)], { type });
    return [name, await createImageBitmap(content, { premultiplyAlpha: "none", colorSpaceConversion: "none" })];
  });
  packet.images = Object.fromEntries(await Promise.all(made));
  return packet;
}
async function asked(what, query = {}) {
  const token = new URLSearchParams(location.search).get("token");
  const reply = await fetch(`${what}?${new URLSearchParams({ token, ...query })}`, { cache: "no-store" });
  if (!reply.ok) throw new Error(await reply.text() || reply.statusText);
  const come = now(), buffer = await reply.arrayBuffer();
  return [buffer, now() - come];
}

// ---- surfaces: positions of size 1 about the origin, x right, y up, z to the viewer ----
let place = setup.place || { centre: [0, 0, 0], size: [1, 1, 1] };
const extent = () => Math.max(...place.size, 1e-9);
function surfaceOfGrid(packet, grid, cut) {  // cut: the outline is the normal map's, finer than the grid
  const [rows, columns] = grid.shape, count = rows * columns, steps = packet.block(grid.at, Uint16Array, count);
  const known = Float32Array.from(steps, (s) => (s === NONE ? -1 : s)), filled = cut ? grown(known, rows, columns) : known;
  const positions = new Float32Array(3 * count), uv = new Float32Array(2 * count), [x0, y0, z0] = place.centre, unit = 1 / extent();
  for (let v = 0, i = 0; v < rows; v++)
    for (let u = 0; u < columns; u++, i++) {
      const z = grid.low + grid.step * filled[i], far = grid.perspective ? z : 1;
      positions[3 * i] = ((u - grid.centre[0]) / grid.focal[0] * far - x0) * unit;
      positions[3 * i + 1] = (-(v - grid.centre[1]) / grid.focal[1] * far - y0) * unit;
      positions[3 * i + 2] = (-z - z0) * unit;
      uv[2 * i] = (u * grid.stride + 0.5) / grid.width;
      uv[2 * i + 1] = (v * grid.stride + 0.5) / grid.height;
    }
  const faces = trianglesOf(filled, rows, columns, grid.jump);
  return { positions, uv, faces, wires: wiresOf(known, rows, columns, grid.jump), normals: cut ? null : vertexNormals(positions, faces) };
}
function grown(known, rows, columns) {  // by one node all around, so that the outline can be cut out of it
  const filled = known.slice();
  for (let v = 0, i = 0; v < rows; v++)
    for (let u = 0; u < columns; u++, i++) {
      if (known[i] >= 0) continue;
      let sum = 0, count = 0;
      for (let b = Math.max(v - 1, 0); b <= Math.min(v + 1, rows - 1); b++)
        for (let a = Math.max(u - 1, 0); a <= Math.min(u + 1, columns - 1); a++)
          if (known[b * columns + a] >= 0) { sum += known[b * columns + a]; count++; }
      if (count) filled[i] = sum / count;
    }
  return filled;
}
function trianglesOf(depth, rows, columns, jump) {  // of three nodes with depth, and no jump between
  const faces = new Uint32Array(6 * Math.max(0, (rows - 1) * (columns - 1)));
  let n = 0;
  const join = (i, j, k) => {
    const a = depth[i], b = depth[j], c = depth[k], low = Math.min(a, b, c);
    if (low >= 0 && Math.max(a, b, c) - low <= jump) { faces[n++] = i; faces[n++] = j; faces[n++] = k; }
  };
  for (let v = 0; v + 1 < rows; v++)
    for (let i = v * columns; i + 1 < (v + 1) * columns; i++) {
      join(i, i + columns, i + 1);
      join(i + 1, i + columns, i + columns + 1);
    }
  return faces.subarray(0, n);
}
function wiresOf(depth, rows, columns, jump) {  // a line every few nodes: one a node would look solid
  const every = Math.max(1, Math.round(Math.sqrt(depth.reduce((sum, d) => sum + (d >= 0), 0) / WIRE_NODES))), wires = [];
  const join = (i, j) => { if (depth[i] >= 0 && depth[j] >= 0 && Math.abs(depth[i] - depth[j]) <= jump) wires.push(i, j); };
  for (let v = 0; v < rows; v += every) for (let u = 0; u + 1 < columns; u++) join(v * columns + u, v * columns + u + 1);
  for (let u = 0; u < columns; u += every) for (let v = 0; v + 1 < rows; v++) join(v * columns + u, (v + 1) * columns + u);
  return Uint32Array.from(wires);
}
function surfaceOfMesh(packet, topology) {  // positions as 16-bit steps of the frame's box
  const { at, low, step, errors } = packet.registered, count = 3 * topology.mesh.vertices, steps = packet.block(at, Uint16Array, count);
  const positions = new Float32Array(count), unit = 1 / extent();
  for (let i = 0; i < count; i++) positions[i] = (low[i % 3] + step[i % 3] * steps[i] - place.centre[i % 3]) * unit;
  const told = errors === undefined ? null : Float32Array.from(packet.block(errors, Uint8Array, topology.mesh.vertices), (e) => e / 255);
  return { ...topology.mesh, positions, normals: vertexNormals(positions, topology.mesh.faces), errors: told };
}
function withMesh(packet) {  // what all frames of a registered surface share
  const { vertices, faces, uv, wires } = packet.mesh, list = ({ at, count }) => packet.block(at, Uint32Array, count);
  const shares = Float32Array.from(packet.block(uv.at, Uint16Array, 2 * vertices), (q) => q / 65535);
  packet.mesh = { vertices, faces: list(faces), wires: list(wires), uv: shares };
  return packet;
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

// ---- drawing ----
const VERTEX = `#version 300 es
in vec3 position; in vec3 normal; in vec2 uv; in float error;
uniform mat3 turned; uniform vec3 shift; uniform vec2 focal, depths; out vec3 vNormal, vSeen; out vec2 vUv; out float vError;
void main() {
  vNormal = normal; vUv = uv; vError = error; vSeen = turned * position + shift;
  gl_Position = vec4(focal * vSeen.xy, depths.x * vSeen.z + depths.y, -vSeen.z);
}`;
const FRAGMENT = `#version 300 es
precision highp float;
in vec3 vNormal, vSeen; in vec2 vUv; in float vError; out vec4 colour;
uniform sampler2D captured, normals; uniform mat3 turned; uniform vec3 light; uniform int look; uniform bool measured;
void main() {
  if (look == 9) { colour = vec4(0.1, 0.42, 1.0, 0.7); return; }  // wires
  vec3 n = vNormal;
  float cover = 1.0;
  if (measured) {
    // alpha is 1 where there is a normal: blurred, so that its steps do not show, then cut along the middle
    vec2 texel = 1.0 / vec2(textureSize(normals, 0));
    vec4 known = texture(normals, vUv), around = vec4(0.0);
    for (int k = 0; k < 4; k++) around += 0.25 * texture(normals, vUv + texel * vec2(k % 2 * 2 - 1, k / 2 * 2 - 1));
    float alpha = 0.5 * (known.a + around.a);
    cover = clamp((alpha - 0.5) / max(fwidth(alpha), 0.001) + 0.5, 0.0, 1.0);
    if (cover == 0.0) discard;
    n = (known.a > 0.3 ? known.rgb : around.rgb) * 2.0 - 1.0;
  }
  n = normalize(n);
  vec3 seen = turned * n;
  if (dot(seen, vSeen) > 0.0) seen = -seen;  // the other side of the surface
  float lit = 0.06 + 0.94 * max(dot(seen, light), 0.0);
  vec3 linear = vec3(0.78, 0.76, 0.73) * lit;
  if (look == 3) {
    vec2 cell = floor(vUv * vec2(32.0, 24.0));
    linear = (mod(cell.x + cell.y, 2.0) < 0.5 ? vec3(0.85, 0.82, 0.78) : vec3(0.62, 0.13, 0.08)) * lit;
  }
  if (look == 4 && vError >= 0.0) {  // share of the error from which a vertex is lost
    vec3 half_way = vec3(0.85, 0.8, 0.5);
    linear = mix(mix(vec3(0.05, 0.2, 0.7), half_way, min(2.0 * vError, 1.0)), vec3(0.7, 0.03, 0.02), max(2.0 * vError - 1.0, 0.0)) * lit;
  }
  vec3 shown = pow(linear, vec3(1.0 / 2.2));
  if (look == 0) shown = texture(captured, vUv).rgb;
  if (look == 2) shown = n * 0.5 + 0.5;
  colour = vec4(shown, cover);
}`;
const UNIFORMS = ["turned", "shift", "focal", "depths", "light", "look", "measured", "captured", "normals"];
const PICTURED = ["captured", "normals"];
let at = {}, buffers = {}, counts = {}, measured = false, software = false;
let turn = { azimuth: 0, elevation: 0, zoom: 1, x: 0, y: 0 }, light = [-0.35, 0.45, 0.82];
function start() {
  const program = gl.createProgram();
  for (const [kind, text] of [[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]]) {
    const shader = gl.createShader(kind);
    gl.shaderSource(shader, text);
    gl.compileShader(shader);
    gl.attachShader(program, shader);
    if (!gl.getShaderParameter(shader, gl.COMPILE_STATUS)) throw new Error(gl.getShaderInfoLog(shader));
  }
  gl.linkProgram(program);
  gl.useProgram(program);
  for (const name of UNIFORMS) at[name] = gl.getUniformLocation(program, name);
  buffers = { faces: gl.createBuffer(), wires: gl.createBuffer() };
  for (const [name, width] of [["positions", 3], ["normals", 3], ["uv", 2], ["errors", 1]]) {
    buffers[name] = gl.createBuffer();
    at[name + "Slot"] = gl.getAttribLocation(program, { positions: "position", normals: "normal", errors: "error" }[name] || name);
    gl.bindBuffer(gl.ARRAY_BUFFER, buffers[name]);
    gl.enableVertexAttribArray(at[name + "Slot"]);
    gl.vertexAttribPointer(at[name + "Slot"], width, gl.FLOAT, false, 0, 0);
  }
  PICTURED.forEach((name, unit) => {
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.bindTexture(gl.TEXTURE_2D, gl.createTexture());
    for (const key of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, key, gl.CLAMP_TO_EDGE);
    for (const key of [gl.TEXTURE_MIN_FILTER, gl.TEXTURE_MAG_FILTER]) gl.texParameteri(gl.TEXTURE_2D, key, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array([128, 128, 255, 255]));
    gl.uniform1i(at[name], unit);
  });
  gl.enable(gl.DEPTH_TEST);
  gl.enable(gl.POLYGON_OFFSET_FILL);
  gl.polygonOffset(2, 2000);  // in depth steps: wires lie before their surface, also where it is level
  gl.blendFunc(gl.SRC_ALPHA, gl.ONE_MINUS_SRC_ALPHA);
  gl.clearColor(0.125, 0.149, 0.184, 1);
  const facts = gl.getExtension("WEBGL_debug_renderer_info");
  software = /swiftshader|llvmpipe|softpipe|software|basic render/i.test(facts ? gl.getParameter(facts.UNMASKED_RENDERER_WEBGL) : "");
  canvas.addEventListener("webglcontextlost", () => setTimeout(() => location.reload(), 1000));
}
function upload(surface, images) {
  for (const name of ["positions", "normals", "uv", "errors", "faces", "wires"]) {
    if (!surface[name]) continue;
    const target = name === "faces" || name === "wires" ? gl.ELEMENT_ARRAY_BUFFER : gl.ARRAY_BUFFER;
    gl.bindBuffer(target, buffers[name]);
    gl.bufferData(target, surface[name], gl.DYNAMIC_DRAW);
  }
  for (const name of ["normals", "errors"]) (surface[name] ? gl.enableVertexAttribArray : gl.disableVertexAttribArray).call(gl, at[name + "Slot"]);
  gl.vertexAttrib1f(at.errorsSlot, -1);  // of a surface that has none
  PICTURED.forEach((name, unit) => {
    if (!images[name]) return;
    gl.activeTexture(gl.TEXTURE0 + unit);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, images[name]);
  });
  counts = { faces: surface.faces.length, wires: surface.wires.length };
  measured = !surface.normals;
}
function focals() {
  const aspect = canvas.clientWidth / Math.max(1, canvas.clientHeight);
  return aspect >= 1 ? [FOCAL / aspect, FOCAL] : [FOCAL, FOCAL * aspect];
}
function distance() {  // all of it fills the view at zoom 1
  const [px, py] = focals(), [x, y, z] = place.size.map((side) => side / extent());
  return (Math.max(px * x, py * y) / (2 * FILLED) + z / 2 + ($("swing").checked ? x / 4 : 0)) / turn.zoom;
}
function render() {
  const begun = now(), scale = LEVELS[level].scale * (level < REDUCED ? window.devicePixelRatio || 1 : 1);
  const width = Math.round(canvas.clientWidth * scale), height = Math.round(canvas.clientHeight * scale);
  if (canvas.width !== width || canvas.height !== height) [canvas.width, canvas.height] = [width, height];
  gl.viewport(0, 0, width, height);
  gl.clear(gl.COLOR_BUFFER_BIT | gl.DEPTH_BUFFER_BIT);
  if (counts.faces) {
    const azimuth = turn.azimuth + ($("swing").checked ? SWING * Math.sin((2 * Math.PI * now()) / 1000 / SWING_S) : 0);
    const [ca, sa, ce, se] = [Math.cos(azimuth), Math.sin(azimuth), Math.cos(turn.elevation), Math.sin(turn.elevation)];
    const away = distance(), near = Math.max(away - 2, 0.01 * away), far = away + 2;
    gl.uniformMatrix3fv(at.turned, false, [ca, sa * se, -sa * ce, 0, ce, se, sa, -ca * se, ca * ce]);  // about y, then x; by columns
    gl.uniform3f(at.shift, -turn.x, -turn.y, -away);
    gl.uniform2fv(at.focal, focals());
    gl.uniform2f(at.depths, (far + near) / (near - far), (2 * far * near) / (near - far));
    gl.uniform3fv(at.light, light);
    gl.uniform1i(at.measured, measured ? 1 : 0);
    gl.uniform1i(at.look, Number($("look").value));
    gl.enable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.faces);
    gl.drawElements(gl.TRIANGLES, counts.faces, gl.UNSIGNED_INT, 0);
    gl.disable(gl.SAMPLE_ALPHA_TO_COVERAGE);
    if ($("wire").checked) {
      gl.uniform1i(at.look, 9);
      gl.enable(gl.BLEND);
      gl.depthMask(false);
      gl.bindBuffer(gl.ELEMENT_ARRAY_BUFFER, buffers.wires);
      gl.drawElements(gl.LINES, counts.wires, gl.UNSIGNED_INT, 0);
      gl.depthMask(true);
      gl.disable(gl.BLEND);
    }
  }
  gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));  // wait, to know what it takes
  paintLight();
  return now() - begun;
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

// ---- how fine, how often ----
let level = 0, finest = 0, usual = null, seen = 0, settled = [0, 0, 0, 0], patience = PATIENCE_MS, started = 0, busy = false, timer = 0;
const period = () => Math.min(1000 / PACE.least, Math.max(1000 / PACE.most[level], (usual || 0) / PACE.share));
function judge(cost) {  // coarser at once, finer with patience, which grows where finer was too slow
  if (++seen < 3) return;  // compiles, makes room
  usual = usual === null ? cost : 0.8 * usual + 0.2 * cost;
  if (seen < 8) return;
  if (usual > PACE.slow && level + 1 < LEVELS.length) {
    settled[level] = now() + patience;
    patience = Math.min(2 * patience, 30 * PATIENCE_MS);
    change(level + 1);
  } else if (usual < PACE.fast && level > finest && now() > settled[level - 1]) change(level - 1);
}
function change(to) {
  const other = LEVELS[to].grid !== LEVELS[level].grid;
  level = to; usual = null; seen = 0;
  $("reduced").hidden = !gl || level < REDUCED;
  if (!live && other && wanted >= 0) show(wanted);
}
async function paint(surface, images, packet, transfer_ms = 0) {  // one at a time; what comes meanwhile is drawn next
  busy = true;
  started = now();
  if (gl && surface) upload(surface, images);
  const rendered_ms = gl ? render() : 0;
  if (packet) for (const [name, image] of Object.entries(packet.images)) paintPicture(name, image);
  const drawn = now();
  await nextFrame();
  const stalled = Math.max(0, now() - drawn - 34);  // the window's next picture takes 17 ms where nothing waits
  if (!live) judge(rendered_ms);
  else if (packet) judge(drawn - started + transfer_ms + stalled);
  busy = false;
  if (!live && gl && $("swing").checked) draw();
}
function draw() {  // soon, but no more often than the budget allows
  if (gl && !timer) timer = setTimeout(() => { timer = 0; if (busy) draw(); else paint(); }, Math.max(0, started + period() - now()));
}
const CAPTIONS = {
  depth: "depth, as relief", dents: "depth below the gel at rest", materials: "materials, each in a colour of its own", shadows: "lights that arrive: white all, dark none", camera: "camera (clipped pixels in magenta)",
};
function paintPicture(name, image) {
  if (!$(name)) {
    const figure = document.createElement("figure"), drawing = document.createElement("canvas"), caption = document.createElement("figcaption");
    drawing.id = name;
    caption.textContent = CAPTIONS[name] || name;
    figure.append(caption, drawing);
    $("pictures").append(figure);
  }
  const target = $(name), context = target.getContext("2d");
  if (target.width !== image.width || target.height !== image.height) [target.width, target.height] = [image.width, image.height];
  if (image instanceof ImageData) context.putImageData(image, 0, 0);
  else { context.clearRect(0, 0, image.width, image.height); context.drawImage(image, 0, 0); }
}
function trouble(text) {
  $("failed").textContent = text;
  $("failed").hidden = !text;
}
const flat = gl ? "" : "This browser shows no WebGL 2; the pictures work all the same.";

// ---- a result: frames in the page, or asked for one by one ----
const registered = () => $("surface").value === "registered";
const frames = new Map();
function frame(index) {
  const query = { index, surface: $("surface").value, grid: LEVELS[level].grid };
  const key = setup.frames ? `${index}` : Object.values(query).join(" ");
  if (!frames.has(key)) {
    const come = (setup.frames ? unfolded(setup.frames[index]) : asked("frame", query).then(([buffer]) => buffer)).then(parsed).then(withImages);
    come.catch(() => frames.delete(key));
    frames.set(key, come);
    if (frames.size > (setup.frames ? 48 : 6)) frames.delete(frames.keys().next().value);
  }
  return frames.get(key);
}
let topology = null, painted = null;
async function shared() {  // what the frames of the registered surface have in common: its faces, and the template's pictures
  topology ||= (setup.topology ? unfolded(setup.topology) : asked("topology").then(([buffer]) => buffer)).then(parsed).then(withMesh);
  painted ||= frame(setup.template);
  return Promise.all([topology, painted]);
}
let wanted = -1;
async function show(index) {
  wanted = index;
  let packet, moving = null;
  try {
    packet = await frame(index);
    if (gl && registered() && packet.registered) moving = await shared();
    if (wanted === index) trouble(flat);
  } catch (problem) {
    topology = painted = null;
    if (wanted === index) trouble(problem.message === "Failed to fetch" ? "no connection: `vntoolkit view` has ended, or its machine cannot be reached" : problem.message);
    return;
  }
  while (busy) await nextFrame();
  if (wanted !== index) return;  // moved on meanwhile
  if (moving) await paint(surfaceOfMesh(packet, moving[0]), moving[1].images, packet);
  else if (gl && packet.own) await paint(surfaceOfGrid(packet, packet.own, "normals" in packet.images), packet.images, packet);
  else { counts = {}; await paint(null, null, packet); }
  for (const drawing of $("pictures").querySelectorAll("canvas")) drawing.style.visibility = drawing.id in packet.images ? "visible" : "hidden";
  $("time").value = index;
  const lacks = moving || packet.own ? "" : ", no depth";
  $("number").textContent = `frame ${setup.numbers[index]}${registered() && !moving && packet.own ? ", not registered" : lacks}`;
  if (wanted === index) document.body.dataset.shown = String(index);  // what tests wait for
}
let playing = 0;
function stop() { playing = 0; $("play").textContent = "play"; }
async function play() {  // a frame is shown before the next is asked for, however long that takes
  const run = playing = now(), count = setup.numbers.length, times = setup.times_s;
  $("play").textContent = "pause";
  while (playing === run) {
    const next = (wanted + 1) % count, mean = times[count - 1] / Math.max(1, count - 1);
    const due = now() + 1000 * Math.max(next ? times[next] - times[wanted] : mean, 1 / 30);
    await show(next);
    frame((next + 1) % count).catch(() => {});
    await sleep(Math.max(0, due - now()));
  }
}
function step(by) {
  stop();
  show(Math.max(0, Math.min(setup.numbers.length - 1, wanted + by)));
}

// ---- a capture: the newest result, whenever the last one is drawn ----
const id = Math.random().toString(36).slice(2);
function element(kind, words, className = "") {
  const made = document.createElement(kind);
  made.textContent = words;
  made.className = className;
  return made;
}
function tell({ status, record }) {
  if (record) $("record").textContent = record;
  if (!status) return;
  const cards = status.cards.map(([value, what, beside]) => {
    const card = element("div", "", "card");
    card.append(element("span", what), element("b", value), element("span", beside));
    return card;
  });
  $("cards").replaceChildren(...cards);
  const notices = status.warnings.map((text) => element("p", `▲ ${text}`, "warning"));
  if (status.recording) notices.unshift(element("p", `● recording ${status.recording}`, "recording"));
  $("notices").replaceChildren(...notices);
}
async function watch() {
  let serial = 0, drawn = now();
  for (;;) {
    if (document.hidden) { await new Promise((done) => document.addEventListener("visibilitychange", done, { once: true })); continue; }
    let packet, transfer_ms;
    try {
      const { grid, normals, camera } = LEVELS[level];
      const [buffer, taken] = await asked("packet", { id, serial, ago_ms: Math.round(now() - drawn), grid, normals, camera });
      packet = buffer.byteLength ? await withImages(parsed(buffer)) : null;
      transfer_ms = taken;
      trouble(flat);
    } catch (problem) {
      trouble("no connection: the capture has ended, or its machine cannot be reached");
      await sleep(3000);
      continue;
    }
    if (!packet) continue;
    while (busy) await nextFrame();
    tell(packet);
    place = packet.place || place;
    await paint(gl && packet.own ? surfaceOfGrid(packet, packet.own, true) : null, packet.images, packet, transfer_ms);
    drawn = now();
    serial = packet.serial;
    document.body.dataset.shown = String(serial);  // what tests wait for
    await sleep(Math.max(0, started + period() - now()));
  }
}
function record() {
  const token = new URLSearchParams(location.search).get("token");
  fetch(`record?${new URLSearchParams({ token })}`, { method: "POST" }).catch(() => {});  // `watch` tells
}

// ---- hands and keys ----
const fingers = new Map();
function moveLight(event) {
  const box = $("light").getBoundingClientRect();
  const x = (event.clientX - box.left) / box.width * 2.2 - 1.1, y = 1.1 - (event.clientY - box.top) / box.height * 2.2;
  const far = Math.max(1, Math.hypot(x, y) / 0.99);
  light = [x / far, y / far, Math.sqrt(Math.max(0, 1 - (x * x + y * y) / (far * far)))];
  draw();
}
function move(dx, dy) {
  const across = 2 * distance() / (focals()[1] * Math.max(1, canvas.clientHeight));  // of a pixel
  turn.x -= dx * across;
  turn.y += dy * across;
}
function zoom(factor) { turn.zoom = Math.max(0.2, Math.min(12, turn.zoom * factor)); }
function dragged(event) {
  const last = fingers.get(event.pointerId);
  if (!last) return;
  const [dx, dy] = [event.clientX - last.x, event.clientY - last.y];
  const other = [...fingers].find(([pointer]) => pointer !== event.pointerId);
  if (other) {  // two fingers: pinch to zoom, both to move
    const apart = (x, y) => Math.max(1, Math.hypot(x - other[1].x, y - other[1].y));
    zoom(apart(event.clientX, event.clientY) / apart(last.x, last.y));
    move(dx / 2, dy / 2);
  } else if (event.shiftKey || event.buttons === 2) move(dx, dy);
  else {
    turn.azimuth += dx * 0.008;
    turn.elevation = Math.max(-1.55, Math.min(1.55, turn.elevation + dy * 0.008));
  }
  fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  draw();
}
function connect() {
  const home = () => { turn = { azimuth: 0, elevation: 0, zoom: 1, x: 0, y: 0 }; draw(); };
  $("light").addEventListener("pointerdown", (event) => { $("light").setPointerCapture(event.pointerId); moveLight(event); });
  $("light").addEventListener("pointermove", (event) => { if (event.buttons) moveLight(event); });
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    fingers.set(event.pointerId, { x: event.clientX, y: event.clientY });
  });
  canvas.addEventListener("pointermove", dragged);
  for (const end of ["pointerup", "pointercancel"]) canvas.addEventListener(end, (event) => fingers.delete(event.pointerId));
  canvas.addEventListener("contextmenu", (event) => event.preventDefault());
  canvas.addEventListener("wheel", (event) => { event.preventDefault(); zoom(Math.exp(-event.deltaY * 0.001)); draw(); }, { passive: false });
  canvas.addEventListener("dblclick", home);
  $("reset").addEventListener("click", home);
  for (const control of ["look", "wire", "swing"]) $(control).addEventListener("change", draw);
  new ResizeObserver(draw).observe(canvas);
}
function keys(event) {
  if (event.ctrlKey || event.metaKey || event.altKey || event.repeat && event.key === "r") return;
  if (live) { if (event.key === "r" && setup.records) record(); return; }
  if (setup.numbers.length < 2 || /^(input|select|button)$/i.test(event.target.tagName)) return;
  if (event.key === " ") { event.preventDefault(); playing ? stop() : play(); }
  if (event.key === "ArrowRight") step(1);
  if (event.key === "ArrowLeft") step(-1);
}

function main() {
  window.addEventListener("keydown", keys);
  if (gl) {
    start();
    if (live) [level, finest] = [REDUCED, software ? REDUCED : 0];
    else if (software && setup.mode === "view") level = 1;
    connect();
  } else {
    for (const control of ["surface", "look", "wire", "swing", "reset"]) if ($(control)) $(control).disabled = true;
    $("light").hidden = $("hint").hidden = true;
  }
  trouble(flat);
  $("swing").checked = live;
  $("reduced").hidden = !gl || level < REDUCED;
  if (live) {
    if (setup.records) $("record").addEventListener("click", (event) => { record(); event.target.blur(); });
    watch();
    return;
  }
  for (const [value, name] of [["own", "of each frame"], ["registered", "registered"]])
    if (setup.surfaces.includes(value)) $("surface").add(new Option(name, value));
  $("surface").addEventListener("change", () => show(wanted));
  $("time").max = setup.numbers.length - 1;
  $("time").disabled = $("play").disabled = setup.numbers.length === 1;
  $("time").addEventListener("input", () => { stop(); show(Number($("time").value)); });
  $("play").addEventListener("click", () => (playing ? stop() : play()));
  show(0);
}
main();
