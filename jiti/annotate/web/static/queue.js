// The list of episodes: by name, or those first whose labels a review is likely to change most.

import { call, count, make, text } from "./api.js";

const SHOWN = 400; // rows in the page at once; the rest is found by typing

export class Queue {
  all = [];
  #current = null;
  #rank = new Map();

  constructor(list, { open }) {
    Object.assign(this, { list, onOpen: open });
    this.find = document.getElementById("find");
    this.order = document.getElementById("order");
    this.order.value = localStorage.getItem("jiti-order") ?? "change";
    this.find.addEventListener("input", () => this.draw());
    this.find.addEventListener("keydown", (event) => {
      if (event.key === "Enter" && this.shown()[0]) this.onOpen(this.shown()[0].episode_id);
      if (event.key === "Escape" || event.key === "Enter") this.find.blur();
    });
    this.order.addEventListener("change", () => {
      localStorage.setItem("jiti-order", this.order.value);
      this.#sort();
      this.draw();
    });
  }

  async refresh() {
    const fresh = this.all.length === 0;
    this.all = (await call("/api/episodes")).episodes;
    if (fresh) this.#sort();
    this.draw();
  }

  // The order stays as it was when it was chosen: reviewing an episode must not move it under one's hands.
  #sort() {
    const rows = this.order.value === "change" ? this.all.toSorted((a, b) => b.expected_change - a.expected_change) : this.all;
    this.#rank = new Map(rows.map((e, k) => [e.episode_id, k]));
  }

  shown() {
    const words = this.find.value.toLowerCase().split(/\s+/).filter(Boolean);
    const fits = (e) => words.every((word) => `${e.title} ${e.task ?? ""}`.toLowerCase().includes(word));
    const rank = (e) => this.#rank.get(e.episode_id) ?? Infinity;
    return this.all.filter(fits).toSorted((a, b) => rank(a) - rank(b));
  }

  first() {
    return this.shown().find((e) => !e.problem)?.episode_id ?? null;
  }

  beside(id, by) {
    const rows = this.shown().filter((e) => !e.problem);
    return rows[rows.findIndex((e) => e.episode_id === id) + by]?.episode_id ?? null;
  }

  withProposals(except) {
    const waiting = this.all.filter((e) => e.proposals && !e.problem && e.episode_id !== except);
    return waiting.toSorted((a, b) => b.expected_change - a.expected_change)[0]?.episode_id ?? null;
  }

  current(id) {
    this.#current = id;
    this.draw();
    this.list.querySelector('[aria-current="true"]')?.scrollIntoView({ block: "nearest" });
  }

  // An episode that could not be opened stays in the list, in red.
  mark(id) {
    const row = this.all.find((e) => e.episode_id === id);
    if (row) row.problem ??= "could not be opened";
    this.draw();
  }

  draw() {
    const rows = this.shown();
    this.list.replaceChildren(...rows.slice(0, SHOWN).map((e) => this.#row(e)));
    if (rows.length > SHOWN) this.list.append(make("li", { className: "quiet", textContent: `… ${rows.length - SHOWN} more: type to find them` }));
    const labelled = this.all.filter((e) => e.segments).length;
    const waiting = this.all.reduce((sum, e) => sum + e.proposals, 0);
    text("progress", `${labelled} of ${this.all.length} labelled${waiting ? `, ${count(waiting, "proposal")}` : ""}`);
  }

  #row(e) {
    const parts = [e.frame_count === null ? "" : count(e.frame_count, "frame"), e.segments ? `${e.segments} ✎` : "", e.undecided ? `${e.undecided} ?` : ""];
    const counts = make("span", { className: "counts", textContent: parts.filter(Boolean).join(" · ") });
    if (e.proposals) counts.append(make("span", { className: "ghosts", textContent: `  ${e.proposals} proposed` }));
    if (e.problem) counts.replaceChildren(make("span", { className: "bad", textContent: "cannot be opened" }));
    const button = make(
      "button",
      { title: e.problem ?? e.task ?? e.title, onclick: () => this.onOpen(e.episode_id), "aria-current": String(e.episode_id === this.#current), data: { episode: e.episode_id } },
      make("span", { className: "name" }, make("bdi", { textContent: e.title })),
      counts,
    );
    return make("li", {}, button);
  }
}
