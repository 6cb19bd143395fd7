// The panel: buttons and sliders that change the look, numbers of both techniques, walks, and what is kept.

import { viewMs } from "/graph.js";

const byId = (id) => document.getElementById(id);
const NO_LIMIT = 31;                  // the budget slider's last step
const spaced = (value) => Math.round(value).toString().replace(/\B(?=(\d{3})+(?!\d))/g, "\u202f");

export function panel({ change, note, download, copyLink, ask, send, save, scale, look, dataset }) {
  const left = byId("left"), right = byId("right"), numbers = byId("numbers"), layer = byId("layer");
  const budget = byId("budget"), threshold = byId("threshold");
  let hello = null, recording = false, playing = null, last = null, told = 0, filming = false;

  // ------------------------------------------------------------------------------------------------- what is chosen

  for (const button of document.querySelectorAll("[data-mode]")) button.addEventListener("click", () => change({ mode: button.dataset.mode }));
  for (const button of document.querySelectorAll("[data-show]")) button.addEventListener("click", () => change({ show: button.dataset.show }));
  for (const side of [left, right]) side.addEventListener("change", () => change({ [side.id]: side.value }));
  for (const name of ["wireframe", "freeze", "worst", "fly", "lossless"]) byId(name).addEventListener("change", (event) => change({ [name]: event.target.checked }));
  layer.addEventListener("change", () => change({ layer: layer.value === "" ? null : Number(layer.value) }));
  budget.addEventListener("input", () => change({ budget_ms: Number(budget.value) >= NO_LIMIT ? null : Number(budget.value) }));
  threshold.addEventListener("input", () => change({ threshold_px: Number(threshold.value) }));
  byId("scale").addEventListener("change", (event) => scale(Number(event.target.value)));
  byId("save").addEventListener("click", () => quietly(save()));
  byId("link").addEventListener("click", copyLink);

  function options(select, entries, value) {
    select.replaceChildren(...entries.map(([name, text]) => new Option(text, name, false, String(name) === String(value))));
  }

  function introduce(found, shownLook) {
    hello = found;
    byId("dataset").textContent = found.dataset;
    byId("about").textContent = `${spaced(found.cells)} viewing ${found.cells === 1 ? "cell" : "cells"}, at most ${found.max_error_px} px wrong at ${found.display[0]} × ${found.display[1]}`;
    for (const side of [left, right]) options(side, found.techniques.map((name) => [name, name]), shownLook[side.id]);
    options(layer, [["", "all layers"], ...found.layers.map((index) => [index, `layer ${index} alone`])], shownLook.layer ?? "");
    layer.disabled = !found.layers.length;
    threshold.max = Math.max(24, Math.ceil(found.max_error_px) + 4);
  }

  function show(now) {
    for (const button of document.querySelectorAll("[data-mode]")) button.setAttribute("aria-pressed", String(button.dataset.mode === now.mode));
    for (const button of document.querySelectorAll("[data-show]")) button.setAttribute("aria-pressed", String(button.dataset.show === now.show));
    left.value = now.left;
    right.value = now.right;
    layer.value = now.layer ?? "";
    for (const name of ["wireframe", "freeze", "worst", "fly", "lossless"]) byId(name).checked = now[name];
    budget.value = now.budget_ms ?? NO_LIMIT;
    byId("budget-text").textContent = now.budget_ms === null ? "no limit" : now.budget_ms === 0 ? "none" : `${now.budget_ms} ms`;
    const limit = now.threshold_px ?? hello?.max_error_px ?? 0;
    threshold.value = limit;
    byId("threshold-text").textContent = now.threshold_px === null ? `${limit} px, as built` : `${limit} px`;
    const renewing = /dynamic|ray-cast|image-cache|:/.test(`${now.mode === "one" ? "" : now.left} ${now.right}`);
    byId("static").hidden = renewing;
    budget.disabled = !renewing;
  }

  // ---------------------------------------------------------------------------------------------------- the numbers

  const ROWS = [
    ["triangles", (view) => spaced(view.triangles)],
    ["draws", (view) => spaced(view.draws)],
    ["milliseconds", (view) => viewMs(view).toFixed(1)],
    ["megabytes", (view) => (view.memory_mb === undefined ? "–" : Number(view.memory_mb).toFixed(1))],
    ["objects as geometry", (view) => (view.near === null || view.near === undefined ? "–" : spaced(view.near))],
    ["layers stored", (view) => view.stored ?? "–"],
    ["captured / reused", (view) => (view.captured === undefined ? "–" : `${view.captured} / ${view.reused}`)],
  ];

  function write(a, b) {
    const sides = [["l", a], ["r", b]].filter(([, view]) => view);
    const head = document.createElement("tr");
    head.append(document.createElement("th"));
    for (const [name, view] of sides) {
      const cell = document.createElement("th");
      cell.scope = "col";
      cell.className = name;
      cell.textContent = cell.title = view.technique;
      head.append(cell);
    }
    const rows = ROWS.map(([name, value]) => {
      const row = document.createElement("tr"), title = document.createElement("th");
      title.scope = "row";
      title.textContent = name;
      row.append(title, ...sides.map(([, view]) => {
        const cell = document.createElement("td");
        cell.textContent = value(view);
        return cell;
      }));
      return row;
    });
    const top = document.createElement("thead"), body = document.createElement("tbody");
    top.append(head);
    body.append(...rows);
    numbers.replaceChildren(top, body);
  }

  const px = (value) => `${Number(value).toFixed(1)} px`;

  function promise(header) {
    const promised = header.promised_px?.thickness ?? null, found = header.worst;
    const whole = hello?.promise_px?.thickness ?? null;
    let text = promised === null ? "Nothing is promised for this view." : `Promised here: no wrong region is thicker than ${px(promised)}.`;
    if (promised === null && whole === null) text = "Nothing is promised for this view: not every cell of this dataset could promise a bound.";
    if (look().worst) {
      if (found?.why) text = found.why;
      if (!header.still) text += " Stand still to have the worst region measured.";
      else if (!found) text += " Measuring\u2026";
      else if (!found.box) text += " Nothing is wrong in this view.";
      else text += ` Worst in this view: ${px(found.thickness_px)} thick; impostors are off by at most ${px(found.displacement_px)}.`;
    }
    byId("promise").textContent = text;
  }

  function frame(header, a, b) {
    const now = performance.now();
    last = header;
    if (now - told > 200 || header.still) {
      told = now;
      write(a, b);
      status(header);
    }
    promise(header);
    recording = header.recording;
    playing = header.playing;
    buttons();
  }

  function buttons() {
    const record = byId("record"), tour = byId("tour");
    record.textContent = recording ? "Stop" : "Record";
    record.classList.toggle("live", recording);
    record.setAttribute("aria-pressed", String(recording));
    tour.textContent = playing ? "Stop the walk" : "Guided tour";
    tour.setAttribute("aria-pressed", String(Boolean(playing)));
  }

  function status(header) {
    const { latencies, drawn } = globalThis.viewer.state;
    const recent = drawn.filter((at) => at > performance.now() - 1000).length;
    const late = latencies.slice(-60).sort((x, y) => x - y);
    const parts = [`${header.width} × ${header.height}`, header.format === "png" ? "lossless" : `JPEG ${header.quality ?? ""}`.trim()];
    if (recent > 2) parts.unshift(`${recent} frames a second`);
    if (late.length) parts.push(`${late[Math.floor(late.length / 2)].toFixed(0)} ms from key to picture`);
    byId("status").textContent = `${parts.join(" · ")}${hello?.device ? `. Drawn by ${hello.device}.` : ""}`;
  }

  // ------------------------------------------------------------------------------------------------------ the walks

  const failed = (error) => note("error", error.message, { kind: "bad", seconds: 6 });
  const quietly = (promised) => promised.catch(failed);

  byId("tour").addEventListener("click", () => quietly(ask({ type: "walk", do: playing ? "stop" : "tour" })));
  byId("record").addEventListener("click", () => {
    if (!recording) {
      quietly(ask({ type: "walk", do: "record" }).then(() => {
        recording = true;
        buttons();
        note("walk", "Recording. Walk, and press Stop when you are there.", { seconds: 5 });
      }));
      return;
    }
    quietly(ask({ type: "walk", do: "stop" }).then(({ walk }) => {
      recording = false;
      buttons();
      if (!walk) return;
      const text = JSON.stringify(walk, null, 1);
      note("walk", "The walk is recorded. compare-impostors --path reads the file.", {
        action: ["Save the file", () => download(`${dataset()}-walk.json`, new Blob([text], { type: "application/json" }))], seconds: 20,
      });
      remembered = true;
    }));
  });

  let remembered = false;             // whether the server has a walk to replay
  byId("replay").addEventListener("click", () => {
    if (remembered) quietly(ask({ type: "walk", do: "replay" }));
    else byId("walk-file").click();
  });
  byId("replay").addEventListener("contextmenu", (event) => { event.preventDefault(); byId("walk-file").click(); });
  byId("walk-file").addEventListener("change", async (event) => {
    const [file] = event.target.files;
    event.target.value = "";
    if (!file) return;
    try {
      if (file.size > 900000) throw new Error(`${file.name}: a walk of at most 900 kB expected, found ${Math.round(file.size / 1000)} kB`);
      let walk;
      try { walk = JSON.parse(await file.text()); } catch { throw new Error(`${file.name}: a walk's file (JSON) expected`); }
      await ask({ type: "walk", do: "replay", walk });
    } catch (error) { failed(error); }
  });

  byId("film").addEventListener("click", async () => {
    if (filming) return;
    filming = true;
    byId("film").disabled = true;
    byId("result").hidden = true;
    progress(0, 0);
    try {
      const { url } = await ask({ type: "film" });
      const video = document.createElement("video"), link = document.createElement("a");
      Object.assign(video, { src: url, controls: true, loop: true, muted: true });
      Object.assign(link, { href: url, download: new URL(url, location.href).pathname.split("/").pop(), textContent: "Save the film" });
      byId("result").replaceChildren(video, link);
      byId("result").hidden = false;
    } catch (error) { failed(error); }
    byId("progress").hidden = true;
    byId("film").disabled = false;
    filming = false;
  });

  function progress(done, of) {
    byId("progress").hidden = false;
    const bar = byId("progress-bar");
    if (of) { bar.max = of; bar.value = done; } else bar.removeAttribute("value");
    byId("progress-text").textContent = of ? `${done} of ${of} frames` : "Filming the tour";
  }

  function message(reply) {
    if (reply.type === "progress") progress(reply.done, reply.of);
  }

  return { hello: (found, now) => { remembered = false; introduce(found, now); }, look: show, frame, message };
}
