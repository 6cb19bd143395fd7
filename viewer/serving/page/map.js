// The map: footprints, cells, what is near and far where somebody stands, and the way that was walked. A click goes there.

const LAYERS = ["#4e9bff", "#b48cff", "#3fd0c9", "#ff8fab", "#a3d65c", "#e0a84e", "#7fa7c9", "#d98cff"];
const HERE = "#ffd166", PICKED = "#ff4f9a", NEAR = "#ffffff", UNSEEN = "#3a4250", GROUND = "#171b21", CELL = "#8a7440";
const MOST_TRACE = 4000;

export function map(box, canvas, key, { go, ask }) {
  let city = null, number = 0, hello = null, colors = {}, header = null, trace = [], waiting = 0, picked = null;
  let view = { x: 0, y: 0, scale: 1 };      // the middle, metres, and pixels a metre
  let byHand = false;                        // moved or zoomed by hand: stays so until somebody walks on
  let base = null;                           // the city as it was drawn last, and around where and for what
  let asked = [0, 0];                        // where the map was asked for, which may be of a part of a large city

  const layerColor = (layer) => colors[layer] ?? LAYERS[layer % LAYERS.length];

  function wake(soon = true) {
    if (!waiting) waiting = soon ? requestAnimationFrame(draw) : setTimeout(() => requestAnimationFrame(draw), 60);
  }

  function layout() {
    const ratio = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    return [width, height, ratio];
  }

  const toScreen = (x, y, width, height) => [width / 2 + (x - view.x) * view.scale, height / 2 - (y - view.y) * view.scale];

  function draw() {
    waiting = 0;
    const [width, height, ratio] = layout();
    if (!width || !height) return;
    const pose = header?.pose;
    if (pose && !byHand) [view.x, view.y] = pose;
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.fillStyle = GROUND;
    pen.fillRect(0, 0, width, height);
    if (city) {
      const of = `${header?.cell} ${picked} ${view.scale} ${width} ${height} ${ratio} ${city.number}`;
      const off = base ? Math.max(Math.abs(view.x - base.x) / width, Math.abs(view.y - base.y) / height) * view.scale : 1;
      if (!base || base.of !== of || off > 0.45) base = { of, x: view.x, y: view.y, picture: drawn(width, height, ratio) };
      const [x, y] = toScreen(base.x, base.y, width, height);
      pen.drawImage(base.picture, x - width, y - height, 2 * width, 2 * height);
    }
    drawTrace(pen, width, height);
    if (pose) drawViewer(pen, pose, width, height);
  }

  /** The city around the middle, twice as wide and high as is shown, so that it serves while somebody walks on. */
  function drawn(width, height, ratio) {
    const picture = new OffscreenCanvas(2 * width * ratio, 2 * height * ratio);
    const pen = picture.getContext("2d");
    const scale = view.scale * ratio;
    pen.setTransform(scale, 0, 0, -scale, width * ratio - view.x * scale, height * ratio + view.y * scale);
    const [left, right] = [view.x - width / view.scale, view.x + width / view.scale];
    const [low, high] = [view.y - height / view.scale, view.y + height / view.scale];
    pen.lineCap = "round";
    const street = (cell, style, least) => {
      pen.strokeStyle = style;
      pen.lineWidth = Math.max(least / view.scale, 2 * cell.half_width);
      pen.beginPath();
      pen.moveTo(...cell.axis[0]);
      pen.lineTo(...cell.axis[1]);
      pen.stroke();
    };
    for (const cell of city.cells) street(cell, CELL, 3);
    for (const cell of city.cells) if (cell.id === header?.cell) street(cell, HERE, 7);   // over its neighbours
    const groups = new Map();                  // colour -> one path for all
    for (const one of city.footprints) {
      const [x0, y0, x1, y1] = one.box;
      if (x1 < left || x0 > right || y1 < low || y0 > high) continue;
      const fill = color(one);
      if (!groups.has(fill)) groups.set(fill, new Path2D());
      groups.get(fill).addPath(one.path);
      if (picked === one.id) groups.set(PICKED, one.path);
    }
    for (const [fill, path] of groups) {
      if (fill === PICKED) continue;
      pen.fillStyle = fill;
      pen.fill(path, "evenodd");
    }
    if (groups.has(PICKED)) {
      pen.strokeStyle = PICKED;
      pen.lineWidth = 3 / view.scale;
      pen.stroke(groups.get(PICKED));
    }
    return picture;
  }

  function color(one) {
    const cell = city.byCell.get(header?.cell);
    if (!cell) return "#566070";
    if (cell.near.has(one.id)) return NEAR;
    const layer = cell.layers.get(one.id);
    if (layer !== undefined) return layerColor(layer);
    return UNSEEN;
  }

  function drawTrace(pen, width, height) {
    pen.strokeStyle = "#ff6b6b";
    pen.lineWidth = 2;
    pen.lineJoin = "round";
    pen.beginPath();
    trace.forEach(([x, y, cut], i) => {
      const at = toScreen(x, y, width, height);
      if (!i || cut) pen.moveTo(...at); else pen.lineTo(...at);
    });
    pen.stroke();
  }

  function drawViewer(pen, pose, width, height) {
    const [x, y] = toScreen(pose[0], pose[1], width, height);
    const upright = Math.tan((0.5 * (hello?.fov_degrees ?? 60) * Math.PI) / 180);   // the height of the window has this angle
    const half = Math.atan((upright * header.width) / header.height);
    pen.fillStyle = "#ffffff38";
    pen.beginPath();
    pen.moveTo(x, y);
    pen.arc(x, y, 46, -pose[3] - half, -pose[3] + half);
    pen.closePath();
    pen.fill();
    pen.beginPath();
    pen.arc(x, y, 4.5, 0, 2 * Math.PI);
    pen.fillStyle = "#ff6b6b";
    pen.fill();
    pen.strokeStyle = "#fff";
    pen.lineWidth = 2;
    pen.stroke();
  }

  // ------------------------------------------------------------------------------------------------------- the mouse

  let pressed = null;
  canvas.addEventListener("pointerdown", (event) => {
    canvas.setPointerCapture(event.pointerId);
    pressed = { x: event.clientX, y: event.clientY, atX: view.x, atY: view.y, moved: false };
  });
  canvas.addEventListener("pointermove", (event) => {
    if (!pressed) return;
    const [dx, dy] = [event.clientX - pressed.x, event.clientY - pressed.y];
    if (!pressed.moved && Math.hypot(dx, dy) < 5) return;
    pressed.moved = byHand = true;
    view.x = pressed.atX - dx / view.scale;
    view.y = pressed.atY + dy / view.scale;
    wake();
  });
  canvas.addEventListener("pointerup", (event) => {
    const one = pressed;
    pressed = null;
    if (!one || one.moved) return;
    const bounds = canvas.getBoundingClientRect();
    go(view.x + (event.clientX - bounds.left - bounds.width / 2) / view.scale, view.y - (event.clientY - bounds.top - bounds.height / 2) / view.scale);
    byHand = false;
  });
  canvas.addEventListener("pointercancel", () => { pressed = null; });
  canvas.addEventListener("wheel", (event) => {
    event.preventDefault();
    zoom(Math.exp(-0.0015 * event.deltaY));
  }, { passive: false });
  canvas.addEventListener("keydown", (event) => {
    if (event.key === "+" || event.key === "=") zoom(1.3);
    else if (event.key === "-") zoom(1 / 1.3);
    else return;
    event.preventDefault();
  });

  function zoom(factor) {
    view.scale = Math.max(0.02, Math.min(20, view.scale * factor));
    wake();
  }

  new ResizeObserver(() => wake()).observe(canvas);
  box.querySelector("#map-grow").addEventListener("click", () => grow());

  function grow() {
    const large = box.classList.toggle("large");
    zoom(large ? 1.6 : 1 / 1.6);
    byHand = false;
  }

  function entry(fill, text) {
    const one = document.createElement("span"), swatch = document.createElement("i");
    swatch.style.background = fill;
    one.append(swatch, text);
    return one;
  }

  // ------------------------------------------------------------------------------------------------------ from outside

  return {
    hello(found) {
      hello = found;
      colors = found.layer_colors ?? {};
      view.scale = 0.45;
      trace = [];
      wake();
    },
    city(reply) {
      const first = city === null;
      city = { ...read(reply), number: number++ };
      if (first && city.whole) view.scale = Math.max(view.scale, Math.min(4, (0.7 * canvas.clientHeight) / extent(city)));
      asked = (header?.pose ?? hello?.pose ?? [0, 0]).slice(0, 2);
      key.replaceChildren(entry(HERE, "cell that you are in"), entry(CELL, "other cells"), entry(NEAR, "near: geometry"), ...(hello?.layers ?? []).slice(0, 8).map((layer) => entry(layerColor(layer), `layer ${layer}`)), entry(UNSEEN, "cannot be seen from here"), entry("#ff6b6b", "where you walked"));
      wake();
    },
    frame(found) {
      const before = header?.pose;
      header = found;
      const [x, y] = found.pose;
      const last = trace[trace.length - 1];
      if (!last || Math.hypot(x - last[0], y - last[1]) > 0.8) {
        trace.push([x, y, Boolean(last) && Math.hypot(x - last[0], y - last[1]) > 25]);
        if (trace.length > MOST_TRACE) trace.splice(0, MOST_TRACE / 4);
        if (!pressed) byHand = false;
        if (city && !city.whole && Math.hypot(x - asked[0], y - asked[1]) > 200) {
          asked = [x, y];
          ask();
        }
      }
      if (!before || before.some((value, i) => value !== found.pose[i])) wake(false);
    },
    picked(reply) {
      picked = reply.id ?? null;
      wake();
    },
    grow,
    shrink() { if (box.classList.contains("large")) grow(); },
  };
}

/** Metres from end to end of a city's buildings and cells. */
function extent({ footprints, cells }) {
  const boxes = [...footprints.map((one) => one.box), ...cells.map(({ axis: [[x0, y0], [x1, y1]] }) => [Math.min(x0, x1), Math.min(y0, y1), Math.max(x0, x1), Math.max(y0, y1)])];
  let [left, low, right, high] = [Infinity, Infinity, -Infinity, -Infinity];
  for (const box of boxes) [left, low, right, high] = [Math.min(left, box[0]), Math.min(low, box[1]), Math.max(right, box[2]), Math.max(high, box[3])];
  return Math.max(right - left, high - low, 1);
}

/** The city of a reply: footprints with their boxes, cells, and of each cell what is near and in which layer things are. */
function read(reply) {
  const footprints = (reply.footprints ?? []).map((one) => {
    const xs = one.rings.flat().map(([x]) => x), ys = one.rings.flat().map(([, y]) => y);
    const path = new Path2D();
    for (const ring of one.rings) {
      ring.forEach(([x, y], i) => (i ? path.lineTo(x, y) : path.moveTo(x, y)));
      path.closePath();
    }
    return { id: one.id, path, box: [Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)] };
  });
  const cells = reply.cells ?? [];
  const byCell = new Map(cells.filter((cell) => cell.near).map((cell) => [cell.id, { near: new Set(cell.near ?? []), layers: new Map(Object.entries(cell.layers ?? {})) }]));
  return { footprints, cells, byCell, whole: reply.whole !== false };
}
