// The shapes of the scene on the canvas, coloured by what the present plan does with them.
"use strict";

const ROLE_COLOURS = {
  target: [0.839, 0.153, 0.157],
  moves: [0.949, 0.760, 0.180],
  cleared: [0.690, 0.478, 0.631],
  stays: [0.80, 0.82, 0.84],
};

class SceneView {
  constructor(canvas, labels, { content, array }, recording) {
    this.canvas = canvas;
    this.labels = labels;
    this.recording = recording;
    this.renderer = new Renderer(canvas);
    this.marks = new Marks(this.renderer);
    this.layers = { regions: true, candidates: true, bases: true, paths: true, names: false, solid: true };
    this.objects = content.objects;
    this.target = content.target.split("/").pop();
    const corners = content.meshes.map((mesh) => Array.from(array(mesh.vertices), (value) => value * mesh.step));
    const meshes = content.meshes.map((mesh, index) =>
      this.renderer.upload(SHAPES.mesh(corners[index], array(mesh.triangles))));
    const ends = corners.map((values) => [Math.min, Math.max].map((most) =>
      [0, 1, 2].map((axis) => values.reduce((best, value, k) => (k % 3 === axis ? most(best, value) : best), most === Math.min ? Infinity : -Infinity))));
    this.geoms = content.geoms.map((geom) => ({
      ...geom,
      place: M.pose(geom.position, geom.quaternion),
      mesh: geom.shape === "mesh" ? meshes[geom.mesh] : this.renderer.upload(SHAPES[geom.shape](geom.size)),
      bounds: boundsOf(geom.shape, geom.size, ends[geom.mesh]),
      object: this.objects.find((object) => object.body === geom.body)?.name,
    }));
    this.tags = this.objects.map((object) => {
      const tag = document.createElement("span");
      tag.textContent = object.name.replace(/^object_/, "");
      labels.append(tag);
      return tag;
    });
  }

  // What the plan does with an object, at a time of the episode.
  role(name, span) {
    if (name === this.target) return "target";
    const done = this.recording.spans.some((other) => {
      const action = this.recording.solves[other.solve]?.actions[other.action];
      return other.end <= span.start + 1e-6 && action?.kind === "place" && action.object === name;
    });
    if (done) return "cleared";
    return this.recording.solves[span.solve]?.clearances?.includes(name) ? "moves" : "stays";
  }

  // What a ray meets first: {object, point}, the object undefined for furniture and the robot; null for nothing.
  under(ray, time) {
    const poses = this.recording.posesAt(time);
    let [best, least] = [null, Infinity];
    for (const geom of this.geoms.filter((one) => one.bounds)) {
      const away = meets(ray, geom.body < 0 ? geom.place : M.multiply(poses[geom.body], geom.place), geom.bounds);
      if (away < least) [best, least] = [geom, away];
    }
    return best && { object: best.object, isFixed: best.body < 0, point: V.add(ray.eye, V.scale(ray.along, least)) };
  }

  draw(time, camera, why) {
    this.fit();
    const span = this.recording.spanAt(time);
    const poses = this.recording.posesAt(time);
    const roles = new Map(this.objects.map(({ name }) => [name, this.role(name, span)]));
    const named = why.colours(span);
    const items = this.geoms.map((geom) => {
      const [r, g, b, a] = geom.colour;
      const matrix = geom.body < 0 ? geom.place : M.multiply(poses[geom.body], geom.place);
      if (geom.shape === "plane") return { mesh: geom.mesh, matrix, colour: [r, g, b, 1], kind: KIND.floor };
      const seen = this.layers.solid || geom.body >= 0 ? a : 0.22 * a;
      const colour = geom.object ? [...(named.get(geom.object) || ROLE_COLOURS[roles.get(geom.object)]), 1] : [r, g, b, seen];
      return { mesh: geom.mesh, matrix, colour, kind: KIND.lit };
    });
    items.push(...this.marks.items(this.recording, span, this.layers), ...why.items(span, this.marks));
    const view = camera.matrix();
    this.renderer.draw(items, view, camera.eye, [...REGION_COLOURS, [0, 0, 0]]);
    this.placeLabels(poses, view, roles, new Set([...named.keys(), why.chosen?.name]));
  }

  fit() {
    const scale = Math.min(window.devicePixelRatio || 1, 2);
    const [width, height] = [this.canvas.clientWidth, this.canvas.clientHeight].map((size) => Math.max(Math.round(size * scale), 1));
    if (this.canvas.width !== width || this.canvas.height !== height) Object.assign(this.canvas, { width, height });
  }

  // Numbers of the objects that the plan moves, or of all.
  placeLabels(poses, view, roles, named) {
    this.objects.forEach((object, index) => {
      const pose = poses[object.body];
      const geom = this.geoms.find((entry) => entry.body === object.body);
      const half = geom ? geom.size[geom.size.length - 1] : 0;
      const [x, y, , w] = M.project(view, [pose[12], pose[13], pose[14] + half]);
      const style = this.tags[index].style;
      style.left = `${(50 * x) / w + 50}%`;
      style.top = `${50 - (50 * y) / w}%`;
      this.tags[index].classList.toggle("chosen", named.has(object.name));
      const isShown = this.layers.names || named.has(object.name) || roles.get(object.name) !== "stays";
      style.display = w > 0 && isShown ? "" : "none";
    });
  }
}
