// The time line: a bar of actions, plans and deviations; play, scrub, speed.
"use strict";

class Timeline {
  constructor(root, recording, live, changed) {
    this.root = root;
    this.recording = recording;
    this.changed = changed;
    this.time = 0;
    this.playing = false;
    this.follows = live; // the newest frame of a running episode
    this.speed = 2;
    this.part = (name) => root.querySelector(`[data-part=${name}]`);
    this.part("play").onclick = () => this.toggle();
    this.part("speed").onchange = (event) => (this.speed = Number(event.target.value));
    const bar = this.part("bar");
    const seek = (event) => {
      const box = bar.getBoundingClientRect();
      this.seek(((event.clientX - box.left) / box.width) * this.recording.duration);
    };
    bar.onpointerdown = (event) => {
      bar.setPointerCapture(event.pointerId);
      seek(event);
    };
    bar.onpointermove = (event) => event.buttons && seek(event);
    window.addEventListener("keydown", (event) => this.key(event));
    this.build();
  }

  build() {
    const { recording } = this;
    const track = this.part("track");
    track.replaceChildren();
    const at = (time) => `${(100 * time) / (recording.duration || 1)}%`;
    const put = (className, start, end, title) => {
      const mark = document.createElement("i");
      mark.className = className;
      mark.style.left = at(start);
      if (end !== null) mark.style.width = at(end - start);
      mark.title = title;
      track.append(mark);
    };
    for (const span of recording.spans) {
      const action = recording.solves[span.solve]?.actions[span.action];
      if (!action) continue;
      const kind = action.object === this.target ? "target" : action.kind;
      put(`span ${kind}`, span.start, span.end, `${describe(action)}, ${span.start.toFixed(1)} s`);
    }
    recording.solves.slice(1).forEach((solve, index) => put("replan", solve.time, null, `plan ${index + 2}`));
    for (const note of recording.notes) put("note", note.time, null, note.text);
    this.seek(this.follows ? recording.duration : this.time, false);
  }

  toggle(wanted = !this.playing) {
    this.playing = wanted;
    if (wanted && this.time >= this.recording.duration && !this.follows) this.time = 0;
    this.last = null;
    this.part("play").textContent = wanted ? "❚❚" : "▶";
    this.part("play").setAttribute("aria-label", wanted ? "pause" : "play");
    if (wanted) requestAnimationFrame((now) => this.tick(now));
  }

  tick(now) {
    if (!this.playing) return;
    const elapsed = this.last === null ? 0 : (now - this.last) / 1000;
    this.last = now;
    const next = this.time + elapsed * this.speed;
    this.seek(next, false);
    if (next >= this.recording.duration) this.toggle(false);
    else requestAnimationFrame((later) => this.tick(later));
  }

  // Go to a time [s]; by the user's hand a running episode is no longer followed.
  seek(time, byHand = true) {
    this.time = Math.min(Math.max(time, 0), this.recording.duration);
    if (byHand) this.follows = this.follows && this.time >= this.recording.duration - 0.1;
    const share = `${(100 * this.time) / (this.recording.duration || 1)}%`;
    this.part("head").style.left = share;
    this.part("clock").textContent = `${this.time.toFixed(1)} / ${this.recording.duration.toFixed(1)} s`;
    this.part("bar").setAttribute("aria-valuenow", this.time.toFixed(1));
    this.part("bar").setAttribute("aria-valuemax", this.recording.duration.toFixed(1));
    this.changed();
  }

  key(event) {
    if (event.target.matches("select, input, textarea") || event.ctrlKey || event.metaKey || event.altKey) return;
    const steps = { ArrowLeft: -0.5, ArrowRight: 0.5, PageUp: -5, PageDown: 5 };
    const isButton = event.target.matches("button, summary");
    if (event.key === " " && !isButton) this.toggle();
    else if (event.key === "Home") this.seek(0);
    else if (event.key === "End") this.seek(this.recording.duration);
    else if (event.key in steps) this.seek(this.time + steps[event.key]);
    else return;
    event.preventDefault();
  }
}
