// Where two annotators disagree, and which of them is right: a settled difference is a row of `adjudicated`.

import { call, make, text } from "/static/api.js";

const WORD = { 1: "pass", 0: "fail", null: "undecided" };

export class Differences {
  #names = [];

  constructor(panel, { onOpen, esaLink, onSettled, onTrouble }) {
    Object.assign(this, { panel, onOpen, esaLink, onSettled, onTrouble });
    this.first = make("select", { onchange: () => this.load() });
    this.second = make("select", { onchange: () => this.load() });
    this.first.setAttribute("aria-label", "First annotator");
    this.second.setAttribute("aria-label", "Second annotator");
    this.result = make("div");
    panel.append(make("div", { className: "pick" }, "Compare", this.first, "with", this.second), this.result);
  }

  annotators(names) {
    if (names.join() === this.#names.join()) return;
    this.#names = names;
    [this.first, this.second].forEach((select, k) => {
      const before = select.value;
      select.replaceChildren(...names.map((name) => make("option", { value: name, textContent: name })));
      select.value = names.includes(before) ? before : (names[k] ?? "");
    });
    if (names.length < 2) this.result.replaceChildren(make("p", { className: "none quiet", textContent: "Differences need two annotators on the same episodes: jiti annotate --annotator NAME." }));
    else this.load();
  }

  async load() {
    const [a, b] = [this.first.value, this.second.value];
    if (!a || !b || a === b) return;
    const answer = await call(`/api/rewards/differences?${new URLSearchParams({ a, b })}`);
    text("difference-count", `(${answer.differences.length})`);
    const kappa = answer.itcs.map((i) => `${i.itc_id.split("/").at(-1)} κ ${i.frame_kappa === null ? "–" : i.frame_kappa.toFixed(2)}`).join(", ");
    const all = answer.itcs.at(-1); // the last row is all ITCs together
    const table = make("table", {}, make("tr", {}, ...["Where", "Frames", a, b, ""].map((head) => make("th", { textContent: head }))));
    for (const difference of answer.differences.slice(0, 200)) table.append(this.#row(difference, a, b));
    this.result.replaceChildren(
      make("p", { className: "pick quiet", textContent: `Temporal IoU ${all?.mean_iou == null ? "–" : all.mean_iou.toFixed(2)}, ${kappa}` }),
      answer.differences.length ? table : make("p", { className: "none quiet", textContent: "No differences are left." }),
    );
  }

  #row(difference, a, b) {
    const segment_id = (difference.a ?? difference.b).segment_id;
    const settle = (side) => async () => {
      try {
        await call("/api/rewards/settle", { a, b, side, segment_id });
      } catch (error) {
        return this.onTrouble(error);
      }
      await this.load();
      return this.onSettled();
    };
    const say = (row) => (row ? `${row.start_frame}–${row.end_frame} ${WORD[row.reward]}` : "nothing");
    const frames = make("button", { textContent: `${difference.start_frame}–${difference.end_frame}`, onclick: () => this.onOpen(difference.episode_id, difference.start_frame) });
    return make(
      "tr",
      {},
      make("td", { textContent: `${difference.episode_id} · ${difference.itc_id.split("/").at(-1)}` }),
      make("td", {}, frames),
      make("td", { textContent: say(difference.a) }),
      make("td", { textContent: say(difference.b) }),
      make("td", {}, make("button", { textContent: `take ${a}`, onclick: settle("a") }), " ", make("button", { textContent: `take ${b}`, onclick: settle("b") }), " ", make("a", { href: this.esaLink({ ...difference, segment_id }), target: "jiti-esa", textContent: "Fix in ESA" })),
    );
  }
}
