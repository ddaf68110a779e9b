// Triangles of the shapes that MuJoCo knows and of the marks on the page: {positions, normals, indices}.
"use strict";

const AROUND = 40;

class Shape {
  constructor() {
    this.positions = [];
    this.normals = [];
    this.indices = [];
  }

  vertex(position, normal) {
    this.positions.push(...position);
    this.normals.push(...normal);
    return this.positions.length / 3 - 1;
  }

  quad(a, b, c, d) {
    this.indices.push(a, b, c, a, c, d);
  }

  // A grid of vertices: point(i, j) returns [position, normal] for i = 0 … rows, j = 0 … columns.
  grid(rows, columns, point) {
    const first = this.positions.length / 3;
    for (let i = 0; i <= rows; i++) for (let j = 0; j <= columns; j++) this.vertex(...point(i, j));
    for (let i = 0; i < rows; i++)
      for (let j = 0; j < columns; j++) {
        const a = first + i * (columns + 1) + j;
        this.quad(a, a + 1, a + columns + 2, a + columns + 1);
      }
  }

  // A flat disc or ring at height z, facing up (side 1) or down (-1).
  ring(inner, outer, z, side = 1) {
    this.grid(1, AROUND, (i, j) => {
      const angle = (side * 2 * Math.PI * j) / AROUND;
      const radius = i ? inner : outer;
      return [[radius * Math.cos(angle), radius * Math.sin(angle), z], [0, 0, side]];
    });
  }
}

const SHAPES = {
  plane() {
    const shape = new Shape();
    const size = 12;
    const corner = [[-size, -size], [size, -size], [size, size], [-size, size]];
    shape.quad(...corner.map(([x, y]) => shape.vertex([x, y, 0], [0, 0, 1])));
    return shape;
  },

  box([hx, hy, hz]) {
    const shape = new Shape();
    for (let axis = 0; axis < 3; axis++)
      for (const side of [-1, 1]) {
        const normal = [0, 0, 0];
        normal[axis] = side;
        const [u, v] = side > 0 ? [(axis + 1) % 3, (axis + 2) % 3] : [(axis + 2) % 3, (axis + 1) % 3];
        const corners = [[-1, -1], [1, -1], [1, 1], [-1, 1]].map(([a, b]) => {
          const p = [0, 0, 0];
          p[axis] = side;
          p[u] = a;
          p[v] = b;
          return shape.vertex([p[0] * hx, p[1] * hy, p[2] * hz], normal);
        });
        shape.quad(...corners);
      }
    return shape;
  },

  // Rounded edges of 4 % of the radius catch the light.
  cylinder([radius, half]) {
    const shape = new Shape();
    const bevel = Math.min(0.04 * radius, 0.2 * half, 0.004);
    const outline = [
      [radius - bevel, half, 0, 1], [radius, half - bevel, 1, 0], [radius, bevel - half, 1, 0], [radius - bevel, -half, 0, -1],
    ];
    shape.grid(3, AROUND, (i, j) => {
      const [r, z, out, up] = outline[i];
      const angle = (2 * Math.PI * j) / AROUND;
      const [c, s] = [Math.cos(angle), Math.sin(angle)];
      return [[r * c, r * s, z], [out * c, out * s, up]];
    });
    shape.indices.reverse();
    shape.ring(0, radius - bevel, half, 1);
    shape.ring(0, radius - bevel, -half, -1);
    return shape;
  },

  ellipsoid([a, b, c]) {
    const shape = new Shape();
    shape.grid(AROUND / 2, AROUND, (i, j) => {
      const [polar, angle] = [(Math.PI * i) / (AROUND / 2), (2 * Math.PI * j) / AROUND];
      const n = [Math.sin(polar) * Math.cos(angle), Math.sin(polar) * Math.sin(angle), Math.cos(polar)];
      return [[a * n[0], b * n[1], c * n[2]], V.unit([n[0] / a, n[1] / b, n[2] / c])];
    });
    shape.indices.reverse();
    return shape;
  },

  sphere: ([radius]) => SHAPES.ellipsoid([radius, radius, radius]),

  capsule([radius, half]) {
    const shape = SHAPES.sphere([radius]);
    for (let k = 2; k < shape.positions.length; k += 3) shape.positions[k] += Math.sign(shape.normals[k]) * half;
    return shape;
  },

  // A flat disc at z = 0.
  disc([radius]) {
    const shape = new Shape();
    shape.ring(0, radius, 0);
    return shape;
  },

  ring([inner, outer]) {
    const shape = new Shape();
    shape.ring(inner, outer, 0);
    return shape;
  },

  // A flat arrowhead along x whose notch is at the origin.
  arrow([length]) {
    const shape = new Shape();
    const points = [[length, 0], [-0.45 * length, 0.45 * length], [0, 0], [-0.45 * length, -0.45 * length]];
    const [tip, left, notch, right] = points.map(([x, y]) => shape.vertex([x, y, 0], [0, 0, 1]));
    shape.indices.push(tip, left, notch, tip, notch, right);
    return shape;
  },

  // A rectangle from (x0, y0) to (x1, y1) at z = 0; its texture has x along the rows.
  sheet([x0, y0, x1, y1]) {
    const shape = new Shape();
    shape.quad(...[[x0, y0], [x1, y0], [x1, y1], [x0, y1]].map(([x, y]) => shape.vertex([x, y, 0], [0, 0, 1])));
    shape.texture = [0, 0, 0, 1, 1, 1, 1, 0];
    return shape;
  },

  // A round line through points [[x, y, z], …].
  tube(points, radius) {
    const shape = new Shape();
    const path = points.filter((p, i) => i === 0 || Math.hypot(...V.sub(p, points[i - 1])) > 1e-4);
    if (path.length < 2) return shape;
    const sides = 8;
    shape.grid(path.length - 1, sides, (i, j) => {
      const along = V.unit(V.sub(path[Math.min(i + 1, path.length - 1)], path[Math.max(i - 1, 0)]));
      const u = V.unit(V.cross(along, Math.abs(along[2]) < 0.9 ? [0, 0, 1] : [1, 0, 0]));
      const v = V.cross(along, u);
      const angle = (2 * Math.PI * j) / sides;
      const n = V.add(V.scale(u, Math.cos(angle)), V.scale(v, Math.sin(angle)));
      return [V.add(path[i], V.scale(n, radius)), n];
    });
    return shape;
  },

  // Triangles of a mesh with one normal for each face, so that edges stay sharp.
  mesh(vertices, triangles) {
    const shape = new Shape();
    for (let k = 0; k < triangles.length; k += 3) {
      const [a, b, c] = [0, 1, 2].map((i) => Array.from(vertices.slice(3 * triangles[k + i], 3 * triangles[k + i] + 3)));
      const normal = V.unit(V.cross(V.sub(b, a), V.sub(c, a)));
      shape.indices.push(shape.vertex(a, normal), shape.vertex(b, normal), shape.vertex(c, normal));
    }
    return shape;
  },
};
