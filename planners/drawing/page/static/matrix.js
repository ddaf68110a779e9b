// Vectors and 4 x 4 matrices (column-major, as WebGL wants them). World frame: z up.
"use strict";

const V = {
  add: (a, b) => [a[0] + b[0], a[1] + b[1], a[2] + b[2]],
  sub: (a, b) => [a[0] - b[0], a[1] - b[1], a[2] - b[2]],
  scale: (a, s) => [a[0] * s, a[1] * s, a[2] * s],
  dot: (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2],
  cross: (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]],
  unit: (a) => V.scale(a, 1 / (Math.hypot(a[0], a[1], a[2]) || 1)),
  mix: (a, b, s) => [a[0] + s * (b[0] - a[0]), a[1] + s * (b[1] - a[1]), a[2] + s * (b[2] - a[2])],
};

const M = {
  multiply(a, b) {
    const out = new Float32Array(16);
    for (let column = 0; column < 4; column++)
      for (let row = 0; row < 4; row++) {
        let sum = 0;
        for (let k = 0; k < 4; k++) sum += a[4 * k + row] * b[4 * column + k];
        out[4 * column + row] = sum;
      }
    return out;
  },

  // A pose: position [m] and quaternion w, x, y, z.
  pose(p, q) {
    const [w, x, y, z] = q;
    return new Float32Array([
      1 - 2 * (y * y + z * z), 2 * (x * y + w * z), 2 * (x * z - w * y), 0,
      2 * (x * y - w * z), 1 - 2 * (x * x + z * z), 2 * (y * z + w * x), 0,
      2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y), 0,
      p[0], p[1], p[2], 1,
    ]);
  },

  // At x, y, z, turned by yaw [rad] about the vertical.
  at: (x, y, z, yaw = 0) => M.pose([x, y, z], [Math.cos(yaw / 2), 0, 0, Math.sin(yaw / 2)]),

  perspective(angle, aspect, near, far) {
    const f = 1 / Math.tan(angle / 2);
    const out = new Float32Array(16);
    out[0] = f / aspect;
    out[5] = f;
    out[10] = (far + near) / (near - far);
    out[11] = -1;
    out[14] = (2 * far * near) / (near - far);
    return out;
  },

  box(half, near, far) {
    const out = new Float32Array(16);
    out[0] = out[5] = 1 / half;
    out[10] = 2 / (near - far);
    out[14] = (far + near) / (near - far);
    out[15] = 1;
    return out;
  },

  lookAt(eye, centre, up) {
    const back = V.unit(V.sub(eye, centre));
    const right = V.unit(V.cross(up, back));
    const above = V.cross(back, right);
    return new Float32Array([
      right[0], above[0], back[0], 0,
      right[1], above[1], back[1], 0,
      right[2], above[2], back[2], 0,
      -V.dot(right, eye), -V.dot(above, eye), -V.dot(back, eye), 1,
    ]);
  },

  // A point [x, y, z] in homogeneous clip coordinates.
  project(m, p) {
    return [0, 1, 2, 3].map((row) => m[row] * p[0] + m[4 + row] * p[1] + m[8 + row] * p[2] + m[12 + row]);
  },
};
