// The layers of a plan: regions and candidates of a clearance, base poses, paths.
"use strict";

const REGION_COLOURS = [[0.298, 0.471, 0.659], [0.949, 0.647, 0.255], [0.45, 0.5, 0.55]];
const GREEN = [0.106, 0.541, 0.227];
const GREY = [0.5, 0.52, 0.55];
const PATH_COLOURS = { drive: [0.38, 0.42, 0.48], pick: [0.85, 0.47, 0.09], place: [0.106, 0.541, 0.227], open: [0.25, 0.36, 0.75], other: GREY };
const NEXT_PATHS = 3; // actions after the present one whose paths are drawn too, faintly
const ABOVE = 0.0015; // [m] that marks lie above what they are on
const LIFT = 0.0006; // of the depth, so that marks do not flicker

// The choice of the clearance that a span belongs to, or of the next one; undefined after the last.
function choiceAt(recording, span) {
  const solve = recording.solves[span.solve];
  if (!solve) return undefined;
  const at = span.action < 0 ? solve.actions.length : span.action;
  const puts = solve.actions.flatMap((action, index) => (action.kind === "place" ? [index] : []));
  const next = puts.findIndex((index) => index >= at);
  return next < 0 ? undefined : solve.choices[next];
}

class Marks {
  constructor(renderer) {
    this.renderer = renderer;
    this.made = new Map();
    this.shapes = {
      free: renderer.upload(SHAPES.disc([0.006])),
      best: renderer.upload(SHAPES.disc([0.009])),
      refused: renderer.upload(SHAPES.disc([0.0035])),
      grasp: renderer.upload(SHAPES.arrow([0.02])),
      takenGrasp: renderer.upload(SHAPES.arrow([0.034])),
      arrow: renderer.upload(SHAPES.arrow([0.07])),
      chosenArrow: renderer.upload(SHAPES.arrow([0.13])),
    };
  }

  // Items made once for a key.
  once(owner, key, make) {
    if (!this.made.has(owner)) this.made.set(owner, new Map());
    const known = this.made.get(owner);
    if (!known.has(key)) known.set(key, make());
    return known.get(key);
  }

  // What to draw at a span of the recording; `layers` says which are wanted.
  items(recording, span, layers) {
    const solve = recording.solves[span.solve];
    if (!solve) return [];
    const at = span.action < 0 ? solve.actions.length : span.action;
    const items = [];
    const belief = solve.beliefs[Math.max(span.action, 0)];
    if (belief && layers.regions) items.push(...this.once(belief, "regions", () => this.regions(belief)));
    const choice = choiceAt(recording, span);
    if (choice && layers.regions) items.push(...this.once(choice, "regions", () => this.regions(choice)));
    if (choice && layers.candidates) items.push(...this.once(choice, "candidates", () => this.candidates(choice)));
    const contact = solve.actions.slice(at).find((action) => action.bases.length);
    if (contact && layers.bases) items.push(...this.once(contact, "bases", () => this.bases(contact, solve)));
    if (layers.paths && !belief)
      solve.actions.slice(at, at + 1 + NEXT_PATHS).forEach((action, index) => {
        const [solid, faint] = this.once(action, "paths", () => this.paths(action));
        items.push(index === 0 ? solid : faint);
      });
    return items.flat();
  }

  regions(choice) {
    return choice.surfaces.map((surface) => {
      const [x0, x1, y0, y1] = surface.extent;
      const [rows, columns] = surface.shape;
      return {
        mesh: this.renderer.upload(SHAPES.sheet([x0, y0, x1, y1])),
        matrix: M.at(0, 0, surface.height + ABOVE),
        colour: [1, 1, 1, 1],
        kind: KIND.regions,
        lift: LIFT,
        texture: this.renderer.texture(surface.cells, columns, rows),
      };
    });
  }

  candidates(choice) {
    const mark = (mesh, [x, y, z], colour, level) =>
      ({ mesh, matrix: M.at(x, y, z + level * ABOVE), colour, kind: KIND.plain, lift: LIFT });
    const items = choice.refused.map((place) => mark(this.shapes.refused, place, [...GREY, 0.7], 2));
    choice.ordered.forEach((place, rank) =>
      items.push(mark(rank < 9 ? this.shapes.best : this.shapes.free, place, [...GREEN, rank < 9 ? 1 : 0.55], 2)));
    if (choice.chosen) {
      const height = choice.surfaces.find(({ extent: [x0, x1, y0, y1] }) =>
        choice.chosen[0] >= x0 && choice.chosen[0] <= x1 && choice.chosen[1] >= y0 && choice.chosen[1] <= y1)?.height;
      const ring = this.renderer.upload(SHAPES.ring([choice.radius - 0.003, choice.radius + 0.003]));
      items.push(mark(ring, [...choice.chosen.slice(0, 2), height ?? choice.surfaces[0].height], [...GREEN, 1], 3));
    }
    return items;
  }

  bases(action, solve) {
    const count = action.bases.length;
    const mark = (mesh, [x, y, yaw], colour, z) => ({ mesh, matrix: M.at(x, y, z, yaw), colour, kind: KIND.plain });
    const items = action.bases.slice(1).map((base, rank) => {
      const share = rank / Math.max(count - 2, 1);
      return mark(this.shapes.arrow, base, [...V.mix([0.1, 0.42, 0.72], [0.62, 0.74, 0.85], share), 0.9], 0.004);
    });
    const radius = solve.base_radius;
    const ring = this.renderer.upload(SHAPES.ring([radius - 0.008, radius]));
    items.push(mark(ring, action.bases[0], [0.85, 0.47, 0.09, 1], 0.006));
    items.push(mark(this.shapes.chosenArrow, action.bases[0], [0.85, 0.47, 0.09, 1], 0.007));
    return items;
  }

  // The gripper's path and that of the base on the floor: while the action runs, and otherwise.
  paths(action) {
    const colour = PATH_COLOURS[action.kind] || PATH_COLOURS.other;
    const floor = action.base_path.map(([x, y]) => [x, y, 0.008]);
    const make = (points, radius, alpha) => ({
      mesh: this.renderer.upload(SHAPES.tube(points, radius)),
      matrix: M.at(0, 0, 0),
      colour: [...colour, alpha],
      kind: alpha === 1 ? KIND.lit : KIND.plain,
    });
    const lines = (radius, alpha) => [make(action.path, radius, alpha), make(floor, radius, alpha)];
    return [lines(0.0045, 1), lines(0.0015, 0.4)];
  }
}
