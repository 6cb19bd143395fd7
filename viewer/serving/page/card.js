// What is known of the building that was clicked.

function element(tag, text) {
  const one = document.createElement(tag);
  if (text !== undefined) one.textContent = text;
  return one;
}

function list(entries) {
  const found = element("dl");
  for (const [name, value] of entries) found.append(element("dt", name), element("dd", String(value)));
  return found;
}

export function card(box, closed) {
  const title = box.querySelector("h2"), body = box.querySelector("#card-body");

  function close() {
    if (box.hidden) return;
    box.hidden = true;
    closed();
  }

  function show(reply) {
    title.textContent = reply.name ?? reply.id ?? "Nothing stands there";
    const parts = [];
    if (reply.how) parts.push(element("p", reply.how));
    if (reply.why) parts.push(element("p", reply.why));
    const attributes = Object.entries(reply.attributes ?? {});
    if (attributes.length) parts.push(element("h3", "From the source"), list(attributes));
    if (reply.weights?.length) parts.push(element("h3", "Parallax against its neighbours"), list(reply.weights.map(([id, px]) => [id, `${Number(px).toFixed(1)} px`])));
    body.replaceChildren(...parts);
    box.hidden = false;
  }

  box.querySelector("#card-close").addEventListener("click", close);
  return { show, close };
}
