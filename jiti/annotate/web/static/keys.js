// Keys to actions: taken at the window before Rerun's viewer sees them, remappable, shown in the help.

import { call, make } from "./api.js";

const NAMES = { " ": "Space" };

// A key as it is shown and stored: `a`, `A`, `Shift+ArrowLeft`, `Ctrl+z`. Letters carry Shift in their case.
export function keyName(event) {
  let key = NAMES[event.key] ?? event.key;
  const printable = event.key.length === 1 && event.key !== " ";
  const ctrl = (event.ctrlKey || event.metaKey) && !event.getModifierState("AltGraph");
  if (ctrl && printable) key = key.toLowerCase();
  const shift = event.shiftKey && (!printable || ctrl);
  const alt = event.altKey && !event.getModifierState("AltGraph");
  return (ctrl ? "Ctrl+" : "") + (alt ? "Alt+" : "") + (shift ? "Shift+" : "") + key;
}

export class Keys {
  #held = null;

  // Actions: [{ id, group, label, keys: [...], run(event), up?(event), repeat? }].
  constructor(actions, { dialog, ready, onChange }) {
    this.actions = actions;
    this.dialog = dialog;
    this.ready = ready;
    this.onChange = onChange;
    dialog.addEventListener("close", () => (this.listening = null));
    this.changed = {};
    this.listening = null;
    window.addEventListener("keydown", (event) => this.#down(event), true);
    window.addEventListener("keyup", (event) => this.#up(event), true);
    window.addEventListener("blur", () => this.#release(null));
    window.addEventListener("keypress", (event) => this.#ours(event) && event.stopImmediatePropagation(), true);
  }

  async load() {
    this.changed = (await call("/api/keys")).keys;
  }

  keysOf(action) {
    return this.changed[action.id] ? [this.changed[action.id]] : action.keys;
  }

  hintFor(id) {
    return this.keysOf(this.actions.find((action) => action.id === id))[0];
  }

  find(name) {
    return this.actions.find((action) => this.keysOf(action).includes(name));
  }

  // Where a person types, or a dialog is open, keys are theirs. Rerun puts a hidden text field on the page, which may
  // have the focus: it is not one of those, wherever it stands.
  #ours(event) {
    if (document.querySelector("dialog[open]")) return false;
    const field = event.target instanceof Element && event.target.closest("input, textarea, select");
    return !field?.closest("header, nav, aside");
  }

  #down(event) {
    if (this.listening) return this.#remap(event);
    if (!this.#ours(event) || ["Shift", "Control", "Alt", "Meta", "AltGraph"].includes(event.key)) return;
    const action = this.find(keyName(event));
    if (!action || (!this.ready() && action.id !== "help")) {
      // Nothing of the viewer's own keys may move its time behind the page's back.
      if (event.target instanceof Element && event.target.closest("#viewer")) event.stopImmediatePropagation();
      return;
    }
    // Enter and Space on a focused button of ours press that button.
    const pressesButton = ["Enter", " "].includes(event.key) && event.target instanceof HTMLButtonElement;
    if (pressesButton) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    if (event.repeat && !action.repeat) return;
    if (action.up) this.#held = { code: event.code, action };
    action.run(event);
  }

  #up(event) {
    if (this.#held?.code === event.code) this.#release(event);
    if (event.target instanceof Element && event.target.closest("#viewer")) event.stopImmediatePropagation();
  }

  #release(event) {
    const held = this.#held;
    this.#held = null;
    held?.action.up(event);
  }

  show(message = "") {
    document.getElementById("keys-trouble").textContent = message;
    const groups = Map.groupBy(this.actions, (action) => action.group);
    const sections = [...groups].map(([group, actions]) =>
      make("section", {}, make("h3", { textContent: group }), ...actions.map((action) => this.#row(action))),
    );
    document.getElementById("keys").replaceChildren(...sections);
    if (!this.dialog.open) this.dialog.showModal();
  }

  #row(action) {
    const button = make("button", { type: "button", textContent: this.keysOf(action).join("  ") });
    button.dataset.action = action.id;
    button.addEventListener("click", () => {
      button.textContent = "press a key";
      button.classList.add("listening");
      this.listening = action;
    });
    return make("div", { className: "key" }, make("span", { textContent: action.label }), button);
  }

  async #remap(event) {
    if (["Shift", "Control", "Alt", "Meta", "AltGraph"].includes(event.key)) return;
    event.preventDefault();
    event.stopImmediatePropagation();
    const action = this.listening;
    this.listening = null;
    const name = keyName(event);
    const taken = this.find(name);
    if (event.key === "Escape") return this.show();
    if (taken && taken !== action) return this.show(`${name} is already used: ${taken.label}. Change that one first.`);
    await this.#change({ ...this.changed, [action.id]: name });
  }

  reset() {
    return this.#change({});
  }

  // A change counts at once, and is taken back when it could not be kept.
  async #change(keys) {
    const before = this.changed;
    this.changed = keys;
    this.onChange();
    this.show();
    try {
      await call("/api/keys", { keys }, "PUT");
    } catch (error) {
      this.changed = before;
      this.onChange();
      this.show(error.message);
    }
  }
}
