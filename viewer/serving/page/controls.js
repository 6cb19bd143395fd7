// How somebody moves: keys, mouse, two thumbs or a gamepad become one message for each frame of the screen, where anything
// changed. Nothing runs while nothing is held.

const WALKING = {
  KeyW: ["forward", 1], ArrowUp: ["forward", 1], KeyS: ["forward", -1], ArrowDown: ["forward", -1],
  KeyA: ["right", -1], KeyD: ["right", 1], KeyE: ["up", 1], KeyQ: ["up", -1],
  ArrowLeft: ["turn", 1], ArrowRight: ["turn", -1], PageUp: ["tilt", 1], PageDown: ["tilt", -1],
};
const CLICK_PX = 5;          // a press that moves by less is a click
const STICK_PX = 55;         // how far a thumb moves to walk at full speed
const DEAD = 0.15;           // of a gamepad's sticks

const clamp = (value) => Math.max(-1, Math.min(1, value));

/** Whether a key belongs to the element that has the focus rather than to walking. */
function taken(event) {
  const element = event.target;
  if (event.ctrlKey || event.metaKey || event.altKey || event.isComposing) return true;
  if (element.closest?.("dialog[open]")) return true;
  if (element.matches?.("textarea, select, input:not([type=checkbox]):not([type=range])")) return true;
  if (element.matches?.("input[type=range], [role=slider]")) return event.code.startsWith("Arrow") || event.code.startsWith("Page");
  return false;
}

/**
 * Listen on the picture and the page. `send(held, look, fast, since)` is called at most once for each frame of the screen, and at once for a key;
 * `act(code, event)` for other keys; `click(x, y)` with a place on the picture, CSS pixels; `radians()` is what a pixel of
 * dragging turns by; `used()` is called when somebody moves.
 */
export function controls(picture, stick, { send, act, click, radians, used }) {
  const keys = new Set();
  const look = [0, 0];
  const pointers = new Map();
  let thumb = { forward: 0, right: 0 };
  let sent = "";
  let waiting = 0;
  let since = 0;             // when the first of what was not sent yet happened

  function held() {
    const sum = { forward: thumb.forward, right: thumb.right, up: 0, turn: 0, tilt: 0 };
    for (const key of keys) {
      const [axis, sign] = WALKING[key] ?? [];
      if (axis) sum[axis] += sign;
    }
    let fast = keys.has("ShiftLeft") || keys.has("ShiftRight");
    for (const pad of pads()) {
      const axis = (i) => (Math.abs(pad.axes[i] ?? 0) > DEAD ? pad.axes[i] : 0);
      const button = (i) => (pad.buttons[i]?.pressed ? 1 : 0);
      sum.forward -= axis(1);
      sum.right += axis(0);
      sum.turn -= axis(2);
      sum.tilt -= axis(3);
      sum.up += button(5) - button(4);
      fast ||= Boolean(button(0));
    }
    for (const name of Object.keys(sum)) sum[name] = Math.round(1000 * clamp(sum[name])) / 1000;
    return [sum, fast];
  }

  function pads() {
    return [...(navigator.getGamepads?.() ?? [])].filter((pad) => pad && pad.connected);
  }

  function frame() {
    waiting = 0;
    const [sum, fast] = held();
    const state = JSON.stringify([sum, fast]);
    const moving = Object.values(sum).some((value) => value !== 0);
    if (state !== sent || look[0] !== 0 || look[1] !== 0) {
      if (send(sum, [look[0], look[1]], fast, since || performance.now())) {
        sent = state;
        if (moving || look[0] !== 0 || look[1] !== 0) used(moving);
      }
      look[0] = look[1] = 0;
    }
    since = 0;
    if (pads().length) wake();
  }

  function wake(event) {
    since ||= event?.timeStamp ?? performance.now();
    if (!waiting) waiting = requestAnimationFrame(frame);
  }

  /** Say at once what is held: keys are few, and a picture is waited for. */
  function tell(event) {
    cancelAnimationFrame(waiting);
    since ||= event.timeStamp;
    frame();
  }

  function stop() {
    keys.clear();
    pointers.clear();
    thumb = { forward: 0, right: 0 };
    stick.hidden = true;
    picture.classList.remove("dragging");
    look[0] = look[1] = 0;
    const [sum, fast] = held();
    const state = JSON.stringify([sum, fast]);
    if (state !== sent && send(sum, [0, 0], fast, performance.now())) sent = state;  // at once: a page in the background has no frames
  }

  addEventListener("keydown", (event) => {
    if (taken(event)) return;
    if (WALKING[event.code] || event.code.startsWith("Shift")) {
      keys.add(event.code);
      if (WALKING[event.code]) event.preventDefault();
      if (!event.repeat) tell(event);
    } else if (!event.repeat || event.key === "," || event.key === ".") {
      if (act(event)) event.preventDefault();
    }
  });
  addEventListener("keyup", (event) => {
    if (keys.delete(event.code)) tell(event);
  });
  addEventListener("blur", stop);
  document.addEventListener("visibilitychange", () => document.hidden && stop());
  addEventListener("gamepadconnected", () => wake());

  picture.addEventListener("pointerdown", (event) => {
    if (event.button !== 0) return;
    picture.focus({ preventScroll: true });
    try { picture.setPointerCapture(event.pointerId); } catch { /* a pointer that is gone already */ }
    const bounds = picture.getBoundingClientRect();
    const walks = event.pointerType === "touch" && event.clientX - bounds.left < 0.42 * bounds.width
      && ![...pointers.values()].some((one) => one.walks);
    pointers.set(event.pointerId, { x: event.clientX, y: event.clientY, startX: event.clientX, startY: event.clientY, moved: false, walks });
    if (!walks) picture.classList.add("dragging");
  });
  picture.addEventListener("pointermove", (event) => {
    const one = pointers.get(event.pointerId);
    if (!one) return;
    const far = Math.hypot(event.clientX - one.startX, event.clientY - one.startY) >= CLICK_PX;
    if (!one.moved && !far) return;
    one.moved = true;
    if (one.walks) {
      const right = (event.clientX - one.startX) / STICK_PX;
      const back = (event.clientY - one.startY) / STICK_PX;
      const reach = Math.max(1, Math.hypot(right, back));
      thumb = { forward: -back / reach, right: right / reach };
      const bounds = picture.getBoundingClientRect();
      stick.hidden = false;
      stick.style.left = `${one.startX - bounds.left}px`;
      stick.style.top = `${one.startY - bounds.top}px`;
      stick.firstElementChild.style.transform = `translate(${30 * thumb.right}px, ${-30 * thumb.forward}px)`;
    } else {
      look[0] += (event.clientX - one.x) * radians();
      look[1] += (event.clientY - one.y) * radians();
    }
    [one.x, one.y] = [event.clientX, event.clientY];
    wake(event);
  });
  const release = (event) => {
    const one = pointers.get(event.pointerId);
    if (!one) return;
    pointers.delete(event.pointerId);
    if (one.walks) {
      thumb = { forward: 0, right: 0 };
      stick.hidden = true;
      wake();
    }
    if (![...pointers.values()].some((other) => !other.walks)) picture.classList.remove("dragging");
    if (!one.moved && event.type === "pointerup") {
      const bounds = picture.getBoundingClientRect();
      click(event.clientX - bounds.left, event.clientY - bounds.top);
    }
  };
  picture.addEventListener("pointerup", release);
  picture.addEventListener("pointercancel", release);
  picture.addEventListener("contextmenu", (event) => event.preventDefault());

  return {
    stop,
    /** Say again what is held, to a server that knows nothing of it. */
    again() { sent = ""; wake(); },
  };
}
