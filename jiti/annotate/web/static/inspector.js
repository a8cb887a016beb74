// The list of segments and proposals, and everything about the one that is selected.

import { count, make } from "./api.js";

const WORD = { 1: "pass", 0: "fail", null: "undecided" };
const GLYPH = { 1: "✓", 0: "✗", null: "?" };

export class Inspector {
  #shown = null;

  constructor(list, panel, actions) {
    Object.assign(this, { list, panel, actions });
  }

  draw(labels, selected, lanes, hint) {
    this.hint = hint;
    const rows = [
      ...labels.segments.map((s) => [s, s.status === "rejected" ? "rejected" : ""]),
      ...labels.proposals.map((s) => [s, "proposed"]),
    ].toSorted(([a], [b]) => a.start_frame - b.start_frame);
    this.list.replaceChildren(...rows.map(([segment, kind]) => this.#row(segment, kind, selected, lanes)));
    const segment = labels.get(selected);
    const shown = segment ? JSON.stringify([segment, labels.isProposal(selected)]) : null;
    if (shown === this.#shown) return;
    this.#shown = shown;
    const note = this.panel.querySelector("textarea");
    const typing = note && document.activeElement === note && note.dataset.segment === selected ? note.value : null;
    this.panel.replaceChildren(...(segment ? this.#panel(segment, labels.isProposal(selected), lanes) : []));
    if (typing !== null) {
      const again = this.panel.querySelector("textarea");
      again.value = typing;
      again.focus();
    }
  }

  #row(segment, kind, selected, lanes) {
    const itc = lanes.find((lane) => lane.itc_id === segment.itc_id);
    const name = (itc?.itc_id ?? segment.itc_id).split("/").at(-1).replaceAll("_", " ");
    const verdict = make("span", { className: "verdict", textContent: GLYPH[segment.reward], data: { verdict: segment.reward } });
    const button = make(
      "button",
      { onclick: () => this.actions.select(segment.segment_id), "aria-current": String(segment.segment_id === selected), data: { segment: segment.segment_id, kind } },
      verdict,
      make("span", { className: `itc ${kind}`, textContent: name, title: segment.itc_id }),
      make("span", { className: "quiet", textContent: `${segment.start_frame}–${segment.end_frame}` }),
    );
    button.setAttribute("aria-label", `${kind} ${name}, frames ${segment.start_frame} to ${segment.end_frame}, ${WORD[segment.reward]}`);
    return make("li", {}, button);
  }

  #panel(segment, proposal, lanes) {
    const itc = lanes.find((lane) => lane.itc_id === segment.itc_id);
    // What is pressed comes before what is read, so that it is in sight on small screens.
    return [
      make("div", {}, make("b", { textContent: `Frames ${segment.start_frame} to ${segment.end_frame}` }), ` · ${count(segment.end_frame - segment.start_frame + 1, "frame")}`),
      ...(proposal ? this.#proposal(segment) : this.#own(segment, lanes)),
      make("div", { textContent: itc?.statement ?? segment.itc_id }),
      make("div", { className: "quiet", textContent: itc?.check ?? "" }),
    ];
  }

  #proposal(segment) {
    const sure = segment.confidence === null ? "no confidence given" : `${Math.round(segment.confidence * 100)}% sure`;
    return [
      make("div", { className: "evidence" }, make("b", { textContent: `Proposed by ${segment.source}: ${WORD[segment.reward]}, ${sure}` }), make("div", { textContent: segment.rationale ?? "" })),
      make("div", { className: "row" }, ...["accept", "edit", "reject"].map((decision) => this.#button(decision, decision, () => this.actions.decide(segment.segment_id, decision)))),
    ];
  }

  #own(segment, lanes) {
    const id = segment.segment_id;
    const note = make("textarea", { value: segment.rationale ?? "", placeholder: "Note", data: { segment: id } });
    note.setAttribute("aria-label", "Note on this segment");
    note.addEventListener("blur", () => this.actions.note(id, note.value));
    note.addEventListener("keydown", (event) => {
      event.stopPropagation();
      if (event.key === "Escape" || (event.key === "Enter" && (event.ctrlKey || event.metaKey))) note.blur();
    });
    const lane = make("select", { onchange: () => this.actions.lane(id, lane.value) });
    lane.setAttribute("aria-label", "Implicit task constraint");
    for (const itc of lanes) lane.append(make("option", { value: itc.itc_id, textContent: itc.itc_id, selected: itc.itc_id === segment.itc_id }));
    const verdicts = [[1, "pass"], [0, "fail"], [null, "undecided"]].map(([reward, word]) => {
      const button = this.#button(word, word, () => this.actions.verdict(id, reward));
      button.setAttribute("aria-pressed", String(segment.reward === reward && segment.status !== "rejected"));
      return button;
    });
    const origin = segment.parent_id ? make("div", { className: "quiet", textContent: `${segment.status} proposal of ${segment.source}` }) : null;
    return [
      make("div", { className: "row" }, ...verdicts, this.#button("delete", "delete", () => this.actions.remove(id))),
      origin,
      make("label", {}, lane),
      note,
    ].filter(Boolean);
  }

  #button(label, action, onclick) {
    return make("button", { onclick, data: { action } }, `${label} `, make("kbd", { textContent: this.hint(action) }));
  }

  focusNote() {
    this.panel.querySelector("textarea")?.focus();
  }
}
