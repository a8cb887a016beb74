// The labels of the open episode: edits go to the server one by one, and show when they are durable.

import { call, episodePath, Line, Refused } from "./api.js";

const announce = new BroadcastChannel("jiti-labels");

export class Labels {
  segments = [];
  proposals = [];
  version = 0;
  canUndo = false;
  canRedo = false;
  problems = [];

  // `onChange()` after each answer; `onSaving(count)`, `onSaved(version)`, `onTrouble(error)` tell how saving goes.
  constructor(handlers) {
    Object.assign(this, handlers);
    this.line = new Line();
    addEventListener("beforeunload", (event) => {
      document.activeElement?.blur?.(); // a note that is being written is saved when it loses the focus
      if (this.line.waiting) event.preventDefault();
    });
  }

  take(episodeId, answer) {
    this.episodeId = episodeId;
    this.segments = (answer.segments ?? this.#with(answer)).toSorted((a, b) => a.start_frame - b.start_frame || a.end_frame - b.end_frame);
    this.proposals = answer.proposals.toSorted((a, b) => a.start_frame - b.start_frame);
    this.version = answer.version;
    this.canUndo = answer.can_undo;
    this.canRedo = answer.can_redo;
    this.problems = answer.label_problems;
    this.onChange();
  }

  // The rows after an edit: the server answers with those that the edit changed.
  #with({ changed, removed }) {
    const gone = new Set([...removed, ...changed.map((s) => s.segment_id)]);
    return [...this.segments.filter((s) => !gone.has(s.segment_id)), ...changed];
  }

  get(id) {
    return this.segments.find((s) => s.segment_id === id) ?? this.proposals.find((s) => s.segment_id === id);
  }

  isProposal(id) {
    return this.proposals.some((s) => s.segment_id === id);
  }

  // Until every edit so far is saved or refused.
  async idle() {
    while (this.line.waiting) await this.line.drained();
  }

  // `build()` is called when the edits before this one are saved, and gives { put, remove } or null to do nothing.
  edit(action, build) {
    return this.#save("/edits", () => {
      const change = build();
      return change && { action, put: change.put ?? [], remove: change.remove ?? [] };
    });
  }

  // Changes fields of one segment, worked out from what it is when its turn comes.
  change(action, id, fields) {
    return this.edit(action, () => {
      const old = this.segments.find((s) => s.segment_id === id);
      const wanted = old && fields(old);
      return wanted && { put: [{ ...pick(old), ...wanted }] };
    });
  }

  undo() {
    return this.#save("/undo", () => (this.canUndo ? {} : null));
  }

  redo() {
    return this.#save("/redo", () => (this.canRedo ? {} : null));
  }

  // `row` goes with it: { segment_id } of the row to be, and { reward } with "edit".
  decide(id, decision, row = {}) {
    return this.#save(`/proposals/${encodeURIComponent(id)}`, () => (this.isProposal(id) ? { decision, ...row } : null));
  }

  async refresh() {
    const id = this.episodeId;
    if (this.line.waiting) return;
    const answer = await call(episodePath(id, "/rows"));
    if (id === this.episodeId && !this.line.waiting) this.take(id, answer);
  }

  #save(path, build) {
    const id = this.episodeId;
    return this.line.add(async () => {
      const body = build(); // the page shows another episode only when all edits of this one are done
      if (!body) return null;
      this.onSaving();
      try {
        const answer = await call(episodePath(id, path), { ...body, based_on: this.version });
        this.take(id, answer);
        this.onSaved(answer.version);
        announce.postMessage(id);
        return answer;
      } catch (error) {
        this.onTrouble(error);
        if (error instanceof Refused && error.status === 409) this.take(id, await call(episodePath(id, "/rows")));
        return null;
      }
    });
  }
}

// The fields that an edit may name; the server works out the rest.
export function pick(segment) {
  const { segment_id, itc_id, start_frame, end_frame, reward, rationale } = segment;
  return { segment_id, itc_id, start_frame, end_frame, reward, rationale: rationale ?? undefined };
}
