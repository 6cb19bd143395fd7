// What is known of what was clicked: what it is, how it is shown, and why.

function element(tag, text, name) {
  const one = document.createElement(tag);
  if (text !== undefined) one.textContent = text;
  if (name) one.className = name;
  return one;
}

function list(entries) {
  const found = element("dl");
  for (const [name, value] of entries) found.append(element("dt", name), element("dd", String(value)));
  return found;
}

const number = (value, unit, digits = 1) => `${Number(value).toFixed(digits)} ${unit}`;
const known = (value) => value !== null && value !== undefined;
const NAMES = { ground: "The ground", sky: "The sky", mover: "Something that moves" };

/** How an object is shown, in a sentence. */
function shown(reply) {
  if (reply.role === "near") return "Near: its geometry is drawn.";
  if (reply.role === "hidden") return "This cell keeps neither geometry nor a layer of it.";
  if (reply.role === "far") {
    const layers = (reply.layers ?? []).map((one) => one.layer);
    const where = layers.length ? `${layers.length === 1 ? "layer" : "layers"} ${layers.join(" and ")}` : "no layer";
    return reply.shown_as === "impostor" ? `Far: an impostor shows it, in ${where}.` : `Far: it is in ${where} of this cell; here its geometry is drawn.`;
  }
  return "";
}

function facts(reply) {
  const found = [];
  if (known(reply.distance_m)) found.push(["distance", number(reply.distance_m, "m")]);
  if (known(reply.height_m)) found.push(["height", number(reply.height_m, "m")]);
  if (known(reply.triangles)) found.push(["triangles", reply.triangles]);
  if (known(reply.displaced_px)) found.push(["drawn off by", number(reply.displaced_px, "px", 2)]);
  if (known(reply.why?.missed_px)) found.push(["its picture misses", `at most ${number(reply.why.missed_px, "px", 2)}`]);
  return found;
}

function weights(why) {
  const table = element("table"), head = element("tr");
  head.append(...["neighbour", "weight", "layer"].map((name) => element("th", name)));
  table.append(head, ...why.neighbours.slice(0, 8).map((one) => {
    const row = element("tr", undefined, one.apart ? "apart" : "");
    row.append(element("td", one.id), element("td", number(one.weight_px, "px")), element("td", one.layer ?? "–"));
    return row;
  }));
  return table;
}

export function card(box, closed) {
  const title = box.querySelector("h2"), body = box.querySelector("#card-body");

  function close() {
    if (box.hidden) return;
    box.hidden = true;
    closed();
  }

  function show(reply) {
    title.textContent = reply.id ?? NAMES[reply.what] ?? "Nothing stands there";
    const parts = [];
    if (shown(reply)) parts.push(element("p", shown(reply)));
    if (reply.why?.waiting) parts.push(element("p", "Why: the cell is being planned again, which takes a few seconds the first time\u2026", "quiet"));
    else if (reply.why?.answer) parts.push(element("p", reply.why.answer));
    if (facts(reply).length) parts.push(list(facts(reply)));
    if (reply.why?.neighbours?.length) {
      parts.push(element("h3", `Parallax with its neighbours; above ${reply.why.threshold_px} px they are in other layers`), weights(reply.why));
    }
    const attributes = Object.entries({ ...reply.kept, ...reply.attributes }).filter(([, value]) => known(value) && typeof value !== "object");
    if (attributes.length) parts.push(element("h3", "What the dataset keeps of it"), list(attributes.map(([name, value]) => [name.replaceAll("_", " "), value])));
    if (reply.attributes_note) parts.push(element("p", reply.attributes_note, "quiet"));
    if (reply.link?.startsWith("https://")) {
      const link = element("a", "Look it up in OpenStreetMap");
      Object.assign(link, { href: reply.link, target: "_blank", rel: "noopener noreferrer" });
      const line = element("p");
      line.append(link);
      parts.push(line);
    }
    body.replaceChildren(...parts);
    box.hidden = false;
  }

  box.querySelector("#card-close").addEventListener("click", close);
  return { show, close, get open() { return !box.hidden; } };
}
