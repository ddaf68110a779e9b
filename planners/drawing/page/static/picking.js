// What is under the pointer: the nearest shape that a ray from the eye meets.
"use strict";

const STILL = 5; // pixels that a pointer may move in a click

// Call `clicked` with the place of each click on an element, in its pixels; a drag is none.
function onClick(element, clicked) {
  let start = null;
  element.addEventListener("pointerdown", (event) => (start = event.isPrimary && event.button === 0 ? event : null));
  element.addEventListener("pointerup", (event) => {
    if (!start || Math.hypot(event.clientX - start.clientX, event.clientY - start.clientY) > STILL) return;
    const box = element.getBoundingClientRect();
    clicked(event.clientX - box.left, event.clientY - box.top);
  });
}

// Corners of the box around a shape in its own frame.
function boundsOf(shape, size, mesh) {
  if (shape === "mesh") return mesh;
  const [a, b, c] = size;
  const half = { sphere: [a, a, a], cylinder: [a, a, b], capsule: [a, a, a + b], box: size, ellipsoid: [a, b, c] }[shape];
  return half ? [V.scale(half, -1), half] : null;
}

// Where a ray {eye, along} first meets a box in the frame of a matrix: a distance, Infinity for nowhere.
function meets({ eye, along }, matrix, [low, high]) {
  const away = V.sub(eye, [matrix[12], matrix[13], matrix[14]]);
  let [near, far] = [0, Infinity];
  for (let axis = 0; axis < 3; axis++) {
    const unit = [matrix[4 * axis], matrix[4 * axis + 1], matrix[4 * axis + 2]];
    const [from, speed] = [V.dot(away, unit), V.dot(along, unit)];
    if (Math.abs(speed) < 1e-9) {
      if (from < low[axis] || from > high[axis]) return Infinity;
      continue;
    }
    const [one, other] = [(low[axis] - from) / speed, (high[axis] - from) / speed];
    near = Math.max(near, Math.min(one, other));
    far = Math.min(far, Math.max(one, other));
  }
  return near <= far ? near : Infinity;
}
