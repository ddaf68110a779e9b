// Reads the content of the page: JSON values, and arrays in one compressed block; see content.py.
"use strict";

const TYPES = { float32: Float32Array, int16: Int16Array, int32: Int32Array, uint8: Uint8Array };
const LENGTH = 2e-4; // [m] a step of a position, and of a quaternion's component: as in content.py
const TURN = 1 / 32767;

// The content of a text, and a function that gives the array of a place.
async function decode(text) {
  const { content, arrays } = JSON.parse(text);
  const packed = Uint8Array.from(atob(arrays), (letter) => letter.charCodeAt(0));
  const stream = new Blob([packed]).stream().pipeThrough(new DecompressionStream("deflate"));
  const bytes = packed.length ? await new Response(stream).arrayBuffer() : new ArrayBuffer(0);
  return { content, array: (place) => new TYPES[place.type](bytes, place.at, place.size) };
}

// What happened: frames, plans, notes. It grows while an episode is running.
class Recording {
  constructor({ content, array }) {
    this.numBodies = content.num_bodies;
    this.times = [];
    this.poses = []; // of each frame, 7 numbers a body
    this.solve = [];
    this.action = [];
    this.phase = [];
    this.solves = [];
    this.notes = [];
    this.spans = []; // {solve, action, start, end}: what was carried out when
    this.add({ content, array });
  }

  // Append what a message holds.
  add({ content, array }) {
    if (content.frames) this.addFrames(content.frames, array);
    if (!content.frames && !content.solves) return;
    for (const solve of content.solves || []) this.solves.push(this.readSolve(solve, array));
    if (content.notes) this.notes.push(...content.notes);
    this.findSpans();
  }

  get duration() {
    return this.times[this.times.length - 1] || 0;
  }

  addFrames(frames, array) {
    const times = array(frames.times);
    const [count, width] = [times.length, 7 * this.numBodies];
    const numbers = array(frames.poses);
    const rows = times.length ? Array.from(times, () => new Float32Array(width)) : [];
    const value = new Int16Array(1);
    for (let column = 0; column < width; column++) {
      const step = column % 7 < 3 ? LENGTH : TURN;
      value[0] = 0;
      for (let i = 0; i < count; i++) {
        value[0] += numbers[column * count + i];
        rows[i][column] = value[0] * step;
      }
    }
    this.poses.push(...rows);
    this.times.push(...times);
    this.solve.push(...array(frames.solve));
    this.action.push(...array(frames.action));
    this.phase.push(...Array.from(array(frames.phase), (index) => frames.phases[index]));
  }

  readSolve(solve, array) {
    const points = (place) => {
      const values = place ? array(place) : [];
      return Array.from({ length: values.length / 3 }, (_, i) => Array.from(values.slice(3 * i, 3 * i + 3)));
    };
    const readSurfaces = (surfaces) => surfaces.map((surface) => ({ ...surface, cells: array(surface.cells) }));
    return {
      ...solve,
      why: solve.why && JSON.parse(new TextDecoder().decode(array(solve.why))),
      beliefs: (solve.beliefs || []).map((surfaces) => ({ surfaces: readSurfaces(surfaces) })),
      actions: solve.actions.map((action) => ({
        ...action, path: points(action.path), base_path: points(action.base_path), bases: points(action.bases),
      })),
      choices: solve.choices.map((choice) => ({
        ...choice, ordered: points(choice.ordered), refused: points(choice.refused),
        refused_by: array(choice.refused_by),
        surfaces: readSurfaces(choice.surfaces),
      })),
    };
  }

  findSpans() {
    this.spans = [];
    for (let i = 0; i < this.times.length; i++) {
      const last = this.spans[this.spans.length - 1];
      const actions = this.solves[this.solve[i]]?.actions.length || 0;
      const action = this.action[i] < actions ? this.action[i] : -1;
      const end = this.times[Math.min(i + 1, this.times.length - 1)];
      if (last && last.solve === this.solve[i] && last.action === action) last.end = end;
      else this.spans.push({ solve: this.solve[i], action, start: this.times[i], end });
    }
  }

  // The span at a time: which plan and action, -1 for waiting.
  spanAt(time) {
    return this.spans.findLast((span) => span.start <= time + 1e-9) || { solve: -1, action: -1, start: 0, end: 0 };
  }

  // Index of the last frame at or before a time.
  frameAt(time) {
    let [low, high] = [0, this.times.length - 1];
    while (low < high) {
      const middle = (low + high + 1) >> 1;
      if (this.times[middle] <= time + 1e-9) low = middle;
      else high = middle - 1;
    }
    return low;
  }

  // Matrices of all bodies at a time.
  posesAt(time) {
    const i = this.frameAt(time);
    const [before, after] = [this.poses[i], this.poses[Math.min(i + 1, this.poses.length - 1)]];
    const span = (this.times[i + 1] ?? this.times[i]) - this.times[i];
    const s = span > 0 ? Math.min(Math.max((time - this.times[i]) / span, 0), 1) : 0;
    return Array.from({ length: this.numBodies }, (_, body) => {
      const pose = Array.from({ length: 7 }, (_, k) => before[7 * body + k] * (1 - s) + after[7 * body + k] * s);
      const norm = Math.hypot(...pose.slice(3)) || 1;
      return M.pose(pose.slice(0, 3), pose.slice(3).map((value) => value / norm));
    });
  }
}
