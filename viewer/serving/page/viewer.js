// The page: it holds one websocket, draws the frames that come, and says what somebody wants to see. The server draws.

import { connection } from "/connection.js";
import { controls } from "/controls.js";
import { graph } from "/graph.js";
import { map } from "/map.js";
import { panel } from "/panel.js";
import { card } from "/card.js";

const byId = (id) => document.getElementById(id);
const stage = byId("stage"), picture = byId("picture"), divider = byId("divider");
const pen = picture.getContext("2d", { alpha: false, desynchronized: false });

const state = {
  hello: null,               // what the server said of the dataset
  look: {},                  // what is shown; ours, told to the server
  header: null,              // of the frame that is on the screen
  inside: null,              // the last pose within a built cell
  linked: readLink(),        // {pose, look} of the address, until it was told
  scale: 1,
  seq: 0,
  times: new Map(),          // number of an input -> when it was sent
  latencies: [],             // milliseconds from an input to its picture, the last ones
  drawn: [],                 // when the last frames were drawn
  ms: [],                    // what they took
  views: new Map(),          // numbers of techniques, as they were last drawn
  flight: null,              // what "fly" was before freezing
};

// ------------------------------------------------------------------------------------------------------- notes, cover

const notes = new Map();

/** Show a note, or change it; `action` is [text, function]; without `text` it goes. */
function note(name, text, { kind = "", action = null, seconds = 0 } = {}) {
  const known = notes.get(name);
  if (!text) {
    known?.element.remove();
    clearTimeout(known?.timer);
    notes.delete(name);
    return;
  }
  const element = known?.element ?? document.createElement("div");
  element.className = `note ${kind}`;
  const body = document.createElement("span");
  body.textContent = text;
  element.replaceChildren(body);
  if (action) {
    const button = document.createElement("button");
    button.type = "button";
    button.textContent = action[0];
    button.addEventListener("click", action[1]);
    element.append(button);
  }
  if (!known) byId("notes").append(element);
  clearTimeout(known?.timer);
  const timer = seconds ? setTimeout(() => note(name, null), 1000 * seconds) : 0;
  notes.set(name, { element, timer });
}

function cover(title, text, clear = false) {
  byId("cover").hidden = !title;
  byId("cover").classList.toggle("clear", clear);
  document.body.classList.toggle("covered", Boolean(title) && !clear);
  if (title) {
    byId("cover-title").textContent = title;
    byId("cover-text").textContent = text;
  }
}

// ------------------------------------------------------------------------------------------------------------ frames

let ready = null;            // {number, header, bitmap} that the screen shows next
let painting = 0;

async function frame(header, body) {
  const arrived = performance.now();
  if (header.saved) {
    server.answered(header);
    keep(header, body);
    return;
  }
  let bitmap = null;
  try {
    bitmap = await createImageBitmap(new Blob([body], { type: `image/${header.format}` }));
  } catch {
    server.send({ type: "ack", frame: header.frame });
    return;
  }
  if (ready && ready.header.frame > header.frame) {
    bitmap.close();
    return;
  }
  ready?.bitmap.close();
  ready = { header, bitmap, arrived };
  if (!painting) painting = requestAnimationFrame(paint);
}

function paint() {
  painting = 0;
  if (!ready) return;
  const { header, bitmap, arrived } = ready;
  ready = null;
  if (picture.width !== bitmap.width || picture.height !== bitmap.height) {
    picture.width = bitmap.width;
    picture.height = bitmap.height;
  }
  pen.drawImage(bitmap, 0, 0);
  bitmap.close();
  server.send({ type: "ack", frame: header.frame });
  count(header, arrived);
  shown(header);
}

function count(header, arrived) {
  const now = performance.now();
  const sent = state.times.get(header.seq);
  if (sent !== undefined) {
    state.latencies.push(now - sent);
    if (state.latencies.length > 400) state.latencies.shift();
  }
  for (const seq of state.times.keys()) if (seq <= header.seq) state.times.delete(seq);
  state.drawn.push(now);
  state.ms.push({ ...header.ms, paint: now - arrived, seq: header.seq });
  for (const one of [state.drawn, state.ms]) if (one.length > 2000) one.shift();
}

function shown(header) {
  const first = state.header === null;
  state.header = header;
  if (first) cover(null);
  const [left, right] = sides(header);
  times.add(header, left, right);
  controlsPanel.frame(header, left, right);
  plan.frame(header);
  if (header.inside) state.inside = header.pose;
  note("outside", header.inside ? null : "You are outside of the built cells, where layers are drawn as geometry.", {
    kind: "warn", action: state.inside ? ["Take me back", () => server.send({ type: "pose", pose: state.inside })] : null,
  });
  const preparing = (header.views ?? []).filter((one) => one.preparing).map((one) => one.technique);
  note("preparing", preparing.length
    ? `${preparing.join(" and ")} is being prepared for this city: meanwhile you see the geometry.` : null, { kind: "warn" });
  note("frozen", header.frozen ? "Frozen: impostors stay as they were. Fly around them." : null, {
    action: ["Unfreeze", () => change({ freeze: false })],
  });
  place(header.worst);
  arrange();
}

/** The views of a header as [left, right]; a side that is not shown is null. */
function sides(header) {
  const views = header.views ?? [];
  for (const one of views) state.views.set(one.technique, one);
  // A blinking picture has one of them at a time; outside of the cells geometry stands in for techniques with layers.
  const find = (name, otherwise) => views.find((one) => one.technique === name)
    ?? (header.inside ? state.views.get(name) : null) ?? otherwise ?? null;
  return [state.look.mode === "one" ? null : find(state.look.left, views[0]), find(state.look.right, views[views.length - 1])];
}

/** Where a place on the stage is in the picture, and back. */
function scaleOfPicture() {
  return [picture.width / stage.clientWidth, picture.height / stage.clientHeight];
}

function place(worst) {
  const box = byId("box");
  box.hidden = !(worst?.box && state.look.worst);
  if (box.hidden) return;
  const [sx, sy] = scaleOfPicture();
  const [x, y, w, h] = worst.box;
  Object.assign(box.style, { left: `${x / sx}px`, top: `${y / sy}px`, width: `${w / sx}px`, height: `${h / sy}px` });
  box.classList.toggle("flip-x", x / sx > 0.55 * stage.clientWidth);
  box.classList.toggle("flip-y", (y + h) / sy > stage.clientHeight - 60);
  box.firstElementChild.textContent = worstText(worst);
}

function worstText(worst) {
  const px = (value) => `${Number(value).toFixed(1)} px`;
  const promised = worst.promised_px?.thickness;
  return `worst region: ${px(worst.thickness_px)} thick` + (promised !== undefined && promised !== null ? `, promised at most ${px(promised)}` : "");
}

// -------------------------------------------------------------------------------------------------------------- look

/** Change fields of the look, here and at the server. */
function change(fields, tell = true) {
  if ("freeze" in fields && fields.freeze !== state.look.freeze) {  // flying around is what freezing is for
    if (fields.freeze) state.flight = state.look.fly;
    fields = { ...fields, fly: fields.freeze ? true : state.flight ?? false };
  }
  Object.assign(state.look, fields);
  if (tell) server.send({ type: "look", look: fields });
  controlsPanel.look(state.look);
  arrange();
}

/** Lay out what stands over the picture. */
function arrange() {
  const { mode, swipe } = state.look;
  const width = stage.clientWidth;
  divider.hidden = mode !== "swipe";
  divider.style.left = `${100 * swipe}%`;
  divider.setAttribute("aria-valuenow", String(Math.round(100 * swipe)));
  const [left, right] = [byId("left-name"), byId("right-name")];
  left.hidden = mode === "one";
  const blinking = mode === "blink" ? state.header?.views?.[0]?.technique : null;
  left.classList.toggle("away", (blinking && blinking !== state.look.left) || (mode === "swipe" && swipe * width < left.offsetWidth + 12));
  right.classList.toggle("away", (blinking && blinking !== state.look.right) || (mode === "swipe" && (1 - swipe) * width < right.offsetWidth + 60));
}

divider.addEventListener("pointerdown", (event) => {
  divider.setPointerCapture(event.pointerId);
  event.preventDefault();
  divider.focus({ preventScroll: true });
});
divider.addEventListener("pointermove", (event) => {
  if (!divider.hasPointerCapture(event.pointerId)) return;
  const bounds = stage.getBoundingClientRect();
  swipeTo((event.clientX - bounds.left) / bounds.width);
});
divider.addEventListener("keydown", (event) => {
  const step = { ArrowLeft: -0.02, ArrowRight: 0.02, PageDown: -0.1, PageUp: 0.1, Home: -1, End: 1 }[event.key];
  if (step === undefined) return;
  swipeTo(state.look.swipe + step);
  event.preventDefault();
});

let swiping = 0;
function swipeTo(share) {
  state.look.swipe = Math.round(1000 * Math.max(0, Math.min(1, share))) / 1000;
  arrange();
  if (!swiping) {
    swiping = requestAnimationFrame(() => {
      swiping = 0;
      server.send({ type: "look", look: { swipe: state.look.swipe } });
    });
  }
}

// ------------------------------------------------------------------------------------------------------------- links

function readLink() {
  const found = new URLSearchParams(location.hash.slice(1));
  const link = { pose: null, look: {} };
  const pose = (found.get("pose") ?? "").split(",").map(Number);
  if (pose.length === 5 && pose.every(Number.isFinite)) link.pose = pose;
  try {
    const look = JSON.parse(found.get("look") ?? "{}");
    if (look && typeof look === "object" && !Array.isArray(look)) link.look = look;
  } catch { /* a link that was cut: the pose may still do */ }
  return link;
}

/** The address of this view: where somebody stands, and what differs from how the viewer starts. */
function address() {
  const usual = state.hello?.look ?? {};
  const look = Object.fromEntries(Object.entries(state.look).filter(([name, value]) => value !== usual[name]));
  const pose = (state.header?.pose ?? state.hello?.pose ?? []).map((value) => Number(value.toFixed(4)));
  const parts = new URLSearchParams({ pose: pose.join(",") });
  if (Object.keys(look).length) parts.set("look", JSON.stringify(look));
  return `${location.origin}${location.pathname}#${parts.toString().replaceAll("%2C", ",")}`;
}

async function copyLink() {
  const link = address();
  history.replaceState(null, "", link);
  try {
    await navigator.clipboard.writeText(link);
    note("link", "The link to this view is copied, and in the address bar.", { seconds: 4 });
  } catch {
    note("link", "The address bar holds the link to this view.", { seconds: 4 });
  }
}

/** Offer bytes as a file. */
function download(name, blob) {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(blob);
  link.download = name;
  link.click();
  setTimeout(() => URL.revokeObjectURL(link.href), 10000);
}

function keep(header, body) {
  const place = (header.pose ?? []).slice(0, 3).map((value) => value.toFixed(1)).join("_");
  download(`${state.hello?.dataset ?? "view"}_${place}.png`, new Blob([body], { type: "image/png" }));
  note("save", "The picture is saved, with its place in it.", { seconds: 4 });
}

// ------------------------------------------------------------------------------------------------------------ server

const server = connection({
  opened() {
    sendSize();
  },
  waiting(before) {
    state.header = null;
    if (before === null) cover("Others wait", "Your place was given to somebody who waited. Move, and you stand in line again.", true);
    else cover("Others look at the moment", before === 0 ? "You are next." : `${before} ${before === 1 ? "is" : "are"} before you. This page lets you in by itself.`);
  },
  hello(hello) {
    const pose = state.linked?.pose ?? state.header?.pose ?? null;
    const look = state.linked?.look ?? state.look;
    state.linked = null;
    state.hello = hello;
    state.look = { ...hello.look };
    state.header = null;
    state.times.clear();
    cover("Opening the city", "Drawing the first picture.");
    document.title = `${hello.dataset} – view-impostors`;
    byId("credits").textContent = hello.credits ?? "";
    controlsPanel.hello(hello, state.look);
    plan.hello(hello);
    times.clear();
    if (pose) server.send({ type: "pose", pose });
    const known = Object.fromEntries(Object.entries(look).filter(([name, value]) => name in hello.look && value !== hello.look[name]));
    if (Object.keys(known).length) change(known);
    else controlsPanel.look(state.look);
    sendSize();
    walking.again();
    askMap();
    arrange();
  },
  frame,
  error(text) {
    note("error", text, { kind: "bad", seconds: 6 });
  },
  message(reply) {
    controlsPanel.message(reply);
  },
  lost(seconds) {
    ready?.bitmap.close();
    ready = null;
    cover("The viewer does not answer", `It was ended, or cannot be reached. This page tries again by itself${seconds > 1 ? ` in ${Math.round(seconds)} s` : ""}.`, true);
  },
});

function askMap() {
  server.ask({ type: "map" }).then((reply) => plan.city(reply), () => {});   // a page without a map does as well
}

function sendSize() {
  const limit = (value, least, most) => Math.max(least, Math.min(most, Math.round(value)));
  server.send({
    type: "size", width: limit(stage.clientWidth * state.scale, 64, 3840), height: limit(stage.clientHeight * state.scale, 64, 2160),
  });
}
let sizing = 0;
new ResizeObserver(() => {
  arrange();
  if (!sizing) sizing = requestAnimationFrame(() => { sizing = 0; sendSize(); });
}).observe(stage);

// ------------------------------------------------------------------------------------------------------------ asking

const asked = card(byId("card"), () => { byId("mark").hidden = true; });

async function pick(x, y) {
  const [sx, sy] = scaleOfPicture();
  const mark = byId("mark");
  Object.assign(mark.style, { left: `${x}px`, top: `${y}px` });
  mark.hidden = false;
  byId("card").classList.toggle("right", x < 0.45 * stage.clientWidth);
  const from = String(state.header?.pose);
  const question = { type: "pick", x: Math.max(0, Math.min(picture.width - 1, Math.floor(x * sx))), y: Math.max(0, Math.min(picture.height - 1, Math.floor(y * sy))) };
  try {
    for (let again = 0; again < 120; again++) {   // why takes longer than what: it is asked for until it is known
      const reply = await server.ask(question);
      if (again && !asked.open) return;
      asked.show(reply);
      plan.picked(reply);
      if (!reply.why?.waiting) return;
      await new Promise((resolve) => setTimeout(resolve, 500));
      if (String(state.header?.pose) !== from) return;   // another building may be at that pixel now
    }
  } catch (error) {
    mark.hidden = true;
    note("error", error.message, { kind: "bad", seconds: 6 });
  }
}

// -------------------------------------------------------------------------------------------------------------- parts

const times = graph(byId("graph"), byId("graph-key"));
const plan = map(byId("map"), byId("map-picture"), byId("map-key"), {
  go: (x, y) => server.send({ type: "go", to: [x, y] }), ask: askMap,
});
const controlsPanel = panel({
  change, note, download, copyLink,
  ask: server.ask, send: server.send,
  save: () => server.ask({ type: "save" }),
  scale(value) { state.scale = value; sendSize(); },
  look: () => state.look,
  dataset: () => state.hello?.dataset ?? "walk",
});

let walked = 0;
const hint = byId("hint");
const walking = controls(picture, byId("stick"), {
  send(held, look, fast, since) {
    state.seq += 1;
    const told = server.send({ type: "input", seq: state.seq, held, look, fast });
    if (told && (look[0] || look[1] || Object.values(held).some(Boolean))) state.times.set(state.seq, since);
    return told;
  },
  act,
  click: pick,
  radians: () => (2 * Math.tan((0.5 * (state.hello?.fov_degrees ?? 60) * Math.PI) / 180)) / Math.max(stage.clientHeight, 1),
  used(moving) {
    byId("mark").hidden = true;
    if (moving && !walked) walked = setTimeout(() => hint.classList.add("gone"), 5000);
  },
});

const KEYS = {
  Digit1: () => change({ mode: "one" }), Digit2: () => change({ mode: "side" }), Digit3: () => change({ mode: "swipe" }),
  Digit4: () => change({ mode: "blink" }), Digit5: () => change({ mode: "difference" }), Digit6: () => change({ mode: "wrong" }),
  KeyN: () => change({ show: "picture" }), KeyL: () => change({ show: "layers" }), KeyZ: () => change({ show: "depth" }), KeyO: () => change({ show: "objects" }),
  KeyX: () => change({ wireframe: !state.look.wireframe }), KeyG: () => change({ freeze: !state.look.freeze }),
  KeyB: () => change({ worst: !state.look.worst }), KeyF: () => change({ fly: !state.look.fly }),
  KeyM: () => plan.grow(), KeyP: () => fold(!document.body.classList.contains("folded")),
  KeyT: () => byId("tour").click(), KeyR: () => byId("record").click(), KeyK: () => byId("save").click(), KeyC: copyLink,
  Comma: () => swipeTo(state.look.swipe - 0.02), Period: () => swipeTo(state.look.swipe + 0.02),
  Escape: () => { asked.close(); plan.shrink(); },
};

function act(event) {
  if (event.key === "?") { help(); return true; }
  const code = event.code.startsWith("Numpad") ? event.code.replace("Numpad", "Digit") : event.code;
  if (!KEYS[code] || !state.hello) return false;
  KEYS[code](event);
  return true;
}

function help() {
  walking.stop();
  if (!byId("help").open) byId("help").showModal();
}

function fold(folded) {
  document.body.classList.toggle("folded", folded);
  byId("unfold").setAttribute("aria-expanded", String(!folded));
}

byId("unfold").addEventListener("click", () => fold(!document.body.classList.contains("folded")));
byId("help-open").addEventListener("click", help);
byId("hint-help").addEventListener("click", help);
byId("help-close").addEventListener("click", () => byId("help").close());
byId("help").addEventListener("click", (event) => event.target === event.currentTarget && event.currentTarget.close());
byId("hint-close").addEventListener("click", () => hint.classList.add("gone"));
addEventListener("hashchange", () => {
  const link = readLink();
  if (link.pose) server.send({ type: "pose", pose: link.pose });
  if (Object.keys(link.look).length) change(link.look);
});
fold(innerWidth < 860);
cover("Opening the city", "Connecting to the viewer.");
server.open();

/** What tests and benchmarks read. */
globalThis.viewer = {
  get state() { return state; },
  measured() { return { latencies: [...state.latencies], drawn: [...state.drawn], ms: [...state.ms] }; },
  restart() { state.latencies.length = 0; state.drawn.length = 0; state.ms.length = 0; state.times.clear(); },
};
