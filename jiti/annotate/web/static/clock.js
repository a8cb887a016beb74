// Frames and display time: frame i is what the viewer shows at displayNs[i].

export class Clock {
  constructor(displayNs) {
    this.ns = displayNs;
    this.last = Math.max(0, displayNs.length - 1);
  }

  clamp(frame) {
    return Math.max(0, Math.min(this.last, Math.round(frame)));
  }

  // The frame shown at a time: the latest that starts at or before it.
  frameAt(ns) {
    let low = 0;
    let high = this.last;
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.ns[middle] <= ns) low = middle;
      else high = middle - 1;
    }
    return low;
  }
}

export const SPEEDS = [0.1, 0.25, 0.5, 1, 2, 4, 8];

// Plays by moving a time forward on each animation frame; the page is the master, the viewer follows.
export class Player {
  playing = false;
  speed = 1;

  constructor(onTime) {
    this.onTime = onTime;
  }

  play(fromNs, toNs, { loopFromNs = null, onEnd = () => {} } = {}) {
    this.stop();
    this.playing = true;
    let now = fromNs;
    let before = performance.now();
    const tick = (stamp) => {
      if (!this.playing) return;
      now += Math.max(0, stamp - before) * 1e6 * this.speed;
      before = stamp;
      if (now >= toNs && loopFromNs === null) {
        this.playing = false;
        this.onTime(toNs);
        onEnd();
        return;
      }
      if (now >= toNs) now = loopFromNs;
      this.onTime(now);
      this.request = requestAnimationFrame(tick);
    };
    this.request = requestAnimationFrame(tick);
  }

  stop() {
    this.playing = false;
    cancelAnimationFrame(this.request);
  }

  changeSpeed(step) {
    const index = SPEEDS.indexOf(this.speed) + step;
    this.speed = SPEEDS[Math.max(0, Math.min(SPEEDS.length - 1, index))];
  }
}
