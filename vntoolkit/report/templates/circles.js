"use strict";
// Contact circles and the gel's corners, dragged by hand. Every drag that ends is sent and written at once.
const $ = (id) => document.getElementById(id);
const canvas = $("canvas"), pen = canvas.getContext("2d"), still = document.createElement("canvas");
const token = new URLSearchParams(location.search).get("token");
const NEAR_PX = 12, BLUE = "#4fa3ff", ORANGE = "#ffb000", FIRST_SHARE = 0.12, HINT_PX = 24;
let presses = [], corners = null, at = 0, cornering = false, held = null, last = null;
let scale = 1, left = 0, top_ = 0, asked = 0;
still.width = 0;  // until a picture has come, there is nothing to draw, drag or remove

const path = (name, query) => `${name}?${new URLSearchParams({ token, ...query })}`;
async function ask(name, query = {}, method = "GET") {
  const reply = await fetch(path(name, query), { method });
  if (!reply.ok) throw new Error(await reply.text());
  return reply;
}
function complain(error) { $("failed").hidden = !error; $("failed").textContent = error ? error.message : ""; }

async function load() {
  const told = await (await ask("/presses")).json();
  ({ presses, corners } = told);
  $("time").max = presses.length - 1;
  last = last || (presses.find((press) => press.circle) || {}).circle;
  await show();
}
async function show() {
  const mine = ++asked, kind = cornering ? "gel" : $("change").checked ? "change" : "press";
  const buffer = await (await ask("/picture", { press: at, kind })).arrayBuffer();
  if (mine !== asked) return;  // another one was asked for meanwhile
  const length = new DataView(buffer).getUint32(0, true);
  const { picture } = JSON.parse(new TextDecoder().decode(new Uint8Array(buffer, 4, length)));
  const [height, width] = picture.shape;
  still.width = width; still.height = height;
  const pixels = new Uint8ClampedArray(buffer, 4 + length + picture.at, 4 * width * height);
  still.getContext("2d").putImageData(new ImageData(pixels, width, height), 0, 0);
  complain(null);
  draw();
}
function draw() {
  const ratio = devicePixelRatio || 1, box = canvas.getBoundingClientRect();
  canvas.width = Math.round(box.width * ratio); canvas.height = Math.round(box.height * ratio);
  const below = HINT_PX * ratio;
  scale = Math.min(canvas.width / still.width, (canvas.height - below) / still.height) * 0.94;
  left = (canvas.width - scale * still.width) / 2; top_ = (canvas.height - below - scale * still.height) / 2;
  pen.imageSmoothingEnabled = scale < 3;
  pen.drawImage(still, left, top_, scale * still.width, scale * still.height);
  pen.lineWidth = 2 * ratio;
  const press = presses[at], circle = press.circle;
  if (cornering) drawCorners(); else if (circle) drawCircle(circle, press.by);
  $("name").textContent = cornering ? "the gel's corners" : press.name;
  $("time").value = at; $("number").textContent = `${at + 1} of ${presses.length}`;
  const none = presses.filter((each) => !each.circle).length;
  const by = { found: "found", label: "from the label", hand: "by hand" }[press.by];
  const [u, v, radius] = circle ? circle.map((value) => value.toFixed(1)) : ["–", "–", "–"];
  const rows = [[`${u}, ${v}`, `u, v of the middle, ${by}`], [radius, "radius in pixels"], [presses.length - none, "presses"], [none, "pictures without one"]];
  $("cards").replaceChildren(...rows.map(([value, name]) => {
    const card = document.createElement("div"), title = document.createElement("span"), number = document.createElement("b");
    card.className = "card"; title.textContent = name; number.textContent = value;
    card.append(number, title); return card;
  }));
}
const onScreen = (u, v) => [left + scale * (u + 0.5), top_ + scale * (v + 0.5)];
function drawCircle([u, v, radius], by) {
  const [x, y] = onScreen(u, v);
  pen.strokeStyle = by === "hand" ? ORANGE : BLUE;
  pen.beginPath(); pen.arc(x, y, scale * radius, 0, 2 * Math.PI); pen.stroke();
  pen.beginPath(); pen.moveTo(x - 6, y); pen.lineTo(x + 6, y); pen.moveTo(x, y - 6); pen.lineTo(x, y + 6); pen.stroke();
}
function drawCorners() {
  pen.strokeStyle = ORANGE; pen.fillStyle = ORANGE;
  const dots = [0, 1, 3, 2].map((k) => onScreen(corners[2 * k], corners[2 * k + 1]));
  pen.beginPath(); dots.forEach(([x, y], k) => (k ? pen.lineTo(x, y) : pen.moveTo(x, y))); pen.closePath(); pen.stroke();
  for (const [x, y] of dots) { pen.beginPath(); pen.arc(x, y, 6, 0, 2 * Math.PI); pen.fill(); }
}

// ---- the pointer ----
function place(event) {
  const box = canvas.getBoundingClientRect(), ratio = canvas.width / box.width;
  return [((event.clientX - box.left) * ratio - left) / scale - 0.5, ((event.clientY - box.top) * ratio - top_) / scale - 0.5];
}
const nearby = () => (NEAR_PX * (devicePixelRatio || 1)) / scale;
canvas.addEventListener("pointerdown", (event) => {
  if (!still.width) return;
  const [u, v] = place(event);
  canvas.setPointerCapture(event.pointerId);
  if (cornering) {
    const away = [0, 1, 2, 3].map((k) => Math.hypot(corners[2 * k] - u, corners[2 * k + 1] - v));
    const nearest = away.indexOf(Math.min(...away));
    held = { corner: nearest };
  } else {
    const press = presses[at], circle = press.circle;
    const distance = circle ? Math.hypot(circle[0] - u, circle[1] - v) : Infinity;
    if (circle && Math.abs(distance - circle[2]) < nearby()) held = { rim: true };
    else if (circle && distance < circle[2]) held = { by: [circle[0] - u, circle[1] - v] };
    else {
      press.circle = [u, v, circle ? circle[2] : last ? last[2] : FIRST_SHARE * still.width];
      held = { by: [0, 0] };
    }
    press.by = "hand";
  }
  move(event);
});
function move(event) {
  if (!held) return;
  const [u, v] = place(event), circle = presses[at].circle;
  if ("corner" in held) { corners[2 * held.corner] = u; corners[2 * held.corner + 1] = v; }
  else if (held.rim) circle[2] = Math.max(1, Math.hypot(circle[0] - u, circle[1] - v));
  else { circle[0] = clamp(u + held.by[0], still.width); circle[1] = clamp(v + held.by[1], still.height); }
  draw();
}
const clamp = (value, size) => Math.min(Math.max(value, 0), size - 1);
canvas.addEventListener("pointermove", move);
for (const kind of ["pointerup", "pointercancel"]) canvas.addEventListener(kind, async () => {
  if (!held) return;
  held = null;
  try {
    if (cornering) { await ask("/corners", { at: corners.join(",") }, "POST"); await load(); }
    else {
      const [u, v, r] = (last = presses[at].circle);
      await ask("/circle", { press: at, u, v, r }, "POST");
    }
    complain(null);
  } catch (error) { await load().catch(() => {}); complain(error); }
});

// ---- buttons and keys ----
function go(step) {
  if (cornering || !still.width) return;
  at = clamp(at + step, presses.length);
  show().catch(complain);
}
async function remove() {
  if (cornering || !still.width) return;
  Object.assign(presses[at], { circle: null, by: "hand" });
  draw();
  await ask("/none", { press: at }, "POST").catch(complain);
}
$("before").onclick = () => go(-1);
$("after").onclick = () => go(1);
$("time").oninput = () => go(Number($("time").value) - at);
$("none").onclick = remove;
$("change").onchange = () => show().catch(complain);
if ($("corners")) $("corners").onclick = () => {
  cornering = !cornering;
  $("corners").textContent = cornering ? "back to the presses" : "gel's corners";
  $("hint").hidden = cornering;
  show().catch(complain);
};
addEventListener("keydown", (event) => {
  if (event.target.tagName === "INPUT" && event.key.startsWith("Arrow")) return;
  if (event.key === "ArrowRight") go(1);
  else if (event.key === "ArrowLeft") go(-1);
  else if (event.key === "x") remove();
});
new ResizeObserver(() => still.width && draw()).observe(canvas);  // also when the cards take some of its room
load().catch(complain);
