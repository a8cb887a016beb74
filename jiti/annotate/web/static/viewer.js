// Hosts Rerun's web viewer from the installed notebook wheel, through anywidget's `render({model, el})`.

import widget from "/rerun/widget.js";

const TIMELINE = "time";
const TOUCH_MS = 1000; // a change of time this soon after the pointer moved in the viewer is a person's
const HIDDEN = { top: "hidden", blueprint: "hidden", selection: "hidden", time: "hidden" };

// The viewer fetches recordings without cookies; ours are behind one that scripts cannot read.
const fetchBare = window.fetch;
window.fetch = (input, init) => {
  const ours = input instanceof Request && new URL(input.url).origin === location.origin;
  return fetchBare(ours ? new Request(input, { credentials: "same-origin" }) : input, init);
};

export class Viewer {
  #listeners = {};
  #url = null;
  #ready;
  #opened = false;
  #wanted = 0;
  #sent = new Set();
  #touchedAt = -Infinity;

  // `onSeek(ns)` is called when a person moves the time inside the viewer; `onOpen()` when a recording has arrived.
  constructor(element, theme, { onSeek, onOpen }) {
    console.debug = () => {}; // the viewer logs tens of thousands of shader lines there, which slows its start
    this.onSeek = onSeek;
    this.onOpen = onOpen;
    const values = { _url: null, _width: "auto", _height: "auto", _theme: theme, _panel_states: HIDDEN, _fallback_token: null };
    let ready;
    this.#ready = new Promise((resolve) => (ready = resolve));
    const model = {
      get: (name) => values[name],
      set() {},
      save_changes() {},
      off() {},
      on: (event, listener) => (this.#listeners[event] = listener),
      // Events come while the viewer draws a frame, when it takes no calls: answer after it.
      send: (message) => (message === "ready" ? ready() : setTimeout(() => this.#heard(JSON.parse(message)))),
    };
    for (const event of ["pointerdown", "pointermove", "pointerup"]) {
      element.addEventListener(event, (e) => (e.type !== "pointermove" || e.buttons) && (this.#touchedAt = performance.now()), true);
    }
    widget.render({ model, el: element });
  }

  async open(url) {
    await this.#ready;
    if (this.#url) this.#send({ type: "close_url", url: this.#url });
    this.#url = new URL(url, location.href).href;
    this.#opened = false;
    this.#send({ type: "open_url", url: this.#url });
  }

  async close() {
    await this.#ready;
    if (this.#url) this.#send({ type: "close_url", url: this.#url });
    this.#url = null;
    this.#opened = false;
  }

  seek(ns) {
    this.#wanted = ns;
    if (!this.#opened) return;
    this.#sent.add(ns);
    if (this.#sent.size > 200) this.#sent.delete(this.#sent.values().next().value);
    this.#send({ type: "time_ctrl", timeline: TIMELINE, time: ns, play: false });
  }

  #send(message) {
    this.#listeners["msg:custom"](message, []);
  }

  #heard(event) {
    if (event.type === "recording_open") {
      this.#opened = true;
      this.seek(this.#wanted);
      this.onOpen();
    } else if (event.type === "timeline_change" && event.timeline === TIMELINE && !this.#sent.has(event.time)) {
      this.seek(this.#wanted);
    } else if (event.type === "time_update" && !this.#sent.has(event.time)) {
      if (performance.now() - this.#touchedAt < TOUCH_MS) this.onSeek(event.time);
      else this.seek(this.#wanted); // the viewer moves by itself while data arrives
    }
  }
}
