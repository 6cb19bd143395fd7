// The time that the last frames took, as two lines over each other, what updates took of them, and their budget.

const FRAMES = 180;

const sum = (ms) => (ms ? ms.plan + ms.requests + ms.draws + ms.loading : 0);

/** Milliseconds that a view of a frame's header took. */
export const viewMs = (view) => (view ? sum(view.ms) : 0);

export function graph(canvas, key) {
  const frames = [];
  let waiting = 0;
  let shown = 0, latest = [];
  const style = getComputedStyle(document.documentElement);
  const color = { left: style.getPropertyValue("--left").trim(), right: style.getPropertyValue("--right").trim() };

  function add(header, left, right) {
    frames.push({
      left: left ? viewMs(left) : null, right: right ? viewMs(right) : null,
      updates: Math.max(left?.ms.requests ?? 0, right?.ms.requests ?? 0), budget: header.budget_ms, still: header.still,
    });
    if (frames.length > FRAMES) frames.shift();
    latest = [left, right];
    wake();
  }

  function wake() {
    if (!waiting) waiting = requestAnimationFrame((now) => { waiting = 0; draw(now, ...latest); });
  }
  new ResizeObserver(wake).observe(canvas);

  function draw(now, left, right) {
    const ratio = devicePixelRatio || 1;
    const width = canvas.clientWidth, height = canvas.clientHeight;
    if (!width || !height) return;
    if (canvas.width !== Math.round(width * ratio) || canvas.height !== Math.round(height * ratio)) {
      canvas.width = Math.round(width * ratio);
      canvas.height = Math.round(height * ratio);
    }
    const pen = canvas.getContext("2d");
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, width, height);
    const ranked = frames.flatMap((one) => [one.left ?? 0, one.right ?? 0]).sort((a, b) => a - b);
    const usual = ranked[Math.floor(0.94 * (ranked.length - 1))] ?? 0;
    const last = frames[frames.length - 1];
    const most = [5, 10, 20, 40, 80, 160, 320, 640].find((limit) => 1.15 * Math.max(usual, last?.budget ?? 0) <= limit) ?? 1280;
    const y = (ms) => height - 1 - (Math.min(ms, most) / most) * (height - 6);
    const x = (i) => width - (frames.length - i) * (width / FRAMES);

    pen.font = "12px system-ui, sans-serif";
    pen.lineWidth = 1;
    for (const share of [0.5, 1]) {
      pen.strokeStyle = "#ffffff17";
      line(pen, 0, y(share * most), width, y(share * most));
      pen.fillStyle = "#a4adb8";
      pen.fillText(`${share * most} ms`, 6, y(share * most) + (share === 1 ? 13 : -4));
    }
    if (frames.some((one) => one.updates > 0)) {
      pen.fillStyle = "#7bd88f66";
      frames.forEach((one, i) => pen.fillRect(x(i), y(one.updates), Math.max(1, width / FRAMES - 0.5), height - y(one.updates)));
    }
    for (const side of ["left", "right"]) {
      pen.strokeStyle = color[side];
      pen.lineWidth = 1.6;
      pen.lineJoin = "round";
      pen.beginPath();
      let drawing = false;
      frames.forEach((one, i) => {
        if (one[side] === null) { drawing = false; return; }
        if (drawing) pen.lineTo(x(i), y(one[side])); else pen.moveTo(x(i), y(one[side]));
        drawing = true;
      });
      pen.stroke();
    }
    if (last && last.budget !== null && last.budget !== undefined) {
      pen.strokeStyle = "#7bd88f";
      pen.lineWidth = 1.2;
      pen.setLineDash([5, 4]);
      line(pen, 0, y(last.budget), width, y(last.budget));
      pen.setLineDash([]);
    }
    if (now - shown > 250 || last?.still) {
      shown = now;
      legend(last, left, right);
    }
  }

  function legend(last, left, right) {
    const entries = [];
    if (left) entries.push([color.left, `${left.technique} ${viewMs(left).toFixed(1)} ms`]);
    if (right) entries.push([color.right, `${right.technique} ${viewMs(right).toFixed(1)} ms`]);
    if (last?.updates > 0 || left?.captured !== undefined && /dynamic/.test(`${left?.technique} ${right?.technique}`))
      entries.push(["#7bd88f", `updates ${last.updates.toFixed(1)} ms, budget ${last.budget === null ? "none" : `${last.budget} ms`}`]);
    key.replaceChildren(...entries.map(([fill, text]) => {
      const entry = document.createElement("span"), swatch = document.createElement("i");
      swatch.style.background = fill;
      entry.append(swatch, text);
      return entry;
    }));
  }

  return { add, clear() { frames.length = 0; } };
}

function line(pen, x0, y0, x1, y1) {
  pen.beginPath();
  pen.moveTo(x0, Math.round(y0) + 0.5);
  pen.lineTo(x1, Math.round(y1) + 0.5);
  pen.stroke();
}
