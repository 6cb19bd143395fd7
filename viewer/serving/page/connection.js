// The websocket: it opens again by itself, takes frames apart, and gives replies to who asked.

const SOONEST = 0.5, LATEST = 8;      // seconds until it tries again
const decoder = new TextDecoder();

/** The token, where the page's address has one; the address bar keeps it no longer than needed. */
function token() {
  const query = new URLSearchParams(location.search);
  const found = query.get("token");
  if (found !== null) {
    query.delete("token");
    const rest = query.toString();
    history.replaceState(null, "", `${location.pathname}${rest ? `?${rest}` : ""}${location.hash}`);
  }
  return found;
}

export function connection(heard) {
  const offered = token();
  const questions = new Map();        // id -> {resolve, reject}
  let socket = null, next = 1, pause = SOONEST;

  function open() {
    const address = new URL("/socket", location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.hash = "";
    address.search = offered === null ? "" : `?token=${encodeURIComponent(offered)}`;
    socket = new WebSocket(address);
    socket.binaryType = "arraybuffer";
    socket.addEventListener("open", () => heard.opened());
    socket.addEventListener("message", (event) => (typeof event.data === "string" ? text(JSON.parse(event.data)) : binary(event.data)));
    socket.addEventListener("close", () => {
      for (const { reject } of questions.values()) reject(new Error("the viewer does not answer"));
      questions.clear();
      heard.lost(pause);
      setTimeout(open, 1000 * pause);
      pause = Math.min(LATEST, 1.7 * pause);
    });
  }

  /** An address on the server with the token: no cookie goes from a frame in a page of another site, such as a notebook's. */
  function known(path) {
    return offered === null ? path : `${path}?token=${encodeURIComponent(offered)}`;
  }

  function binary(data) {
    const length = new DataView(data).getUint32(0, true);
    const header = JSON.parse(decoder.decode(new Uint8Array(data, 4, length)));
    heard.frame(header, new Uint8Array(data, 4 + length));
  }

  /** A message that is an answer goes to who asked. */
  function answered(message) {
    const question = questions.get(message.for);
    questions.delete(message.for);
    question?.resolve(message);
  }

  function text(message) {
    const question = questions.get(message.for);
    if (question && message.type !== "progress") {
      questions.delete(message.for);
      if (message.type === "error") question.reject(new Error(message.text));
      else question.resolve(message.url === undefined ? message : { ...message, url: known(message.url) });
      return;
    }
    if (message.type === "hello") {
      pause = SOONEST;
      heard.hello(message);
    } else if (message.type === "waiting") heard.waiting(message.before);
    else if (message.type === "error") heard.error(message.text);
    else heard.message(message);
  }

  /** Whether it could be sent. */
  function send(message) {
    if (socket?.readyState !== WebSocket.OPEN) return false;
    socket.send(JSON.stringify(message));
    return true;
  }

  /** The reply to a message, in time. */
  function ask(message) {
    return new Promise((resolve, reject) => {
      const id = next++;
      questions.set(id, { resolve, reject });
      if (!send({ ...message, id })) {
        questions.delete(id);
        reject(new Error("the viewer does not answer"));
      }
    });
  }

  return { open, send, ask, answered };
}
