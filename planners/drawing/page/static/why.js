// "Why?": what refuses each grasp of an object or a place, and what the other ways cost.
"use strict";

const ROWS = 5; // rows of grasps that are shown before "more"
const NEAR_PLACE = 0.05; // [m] from a click to a candidate place
const STATE_COLOURS = { free: [0.106, 0.541, 0.227], blocked: [0.85, 0.47, 0.09], furniture: GREY, unreached: GREY };
const SIDES = ["the front", "the front right", "the right", "the back right", "the back", "the back left", "the left", "the front left"];

const shortName = (name) => name.replace(/^object_/, "");
const listed = (words) => words.length < 2 ? words.join("") : `${words.slice(0, -1).join(", ")} and ${words[words.length - 1]}`;
const counted = (count, word) => `${count} ${word}${count === 1 ? "" : "s"}`;

// Where grasps come from, in words: "level from the front and the left".
function described(grasps, front) {
  const words = new Map();
  for (const [, , , yaw, pitch] of grasps) {
    const way = pitch < 5 ? "level from" : pitch > 85 ? "from above" : `${Math.round(pitch)}° down from`;
    const turn = ((yaw - (front * 180) / Math.PI + 360 * 2 + 22.5) % 360) / 45;
    if (!words.has(way)) words.set(way, new Set());
    words.get(way).add(SIDES[Math.floor(turn)]);
  }
  return [...words].map(([way, sides]) => {
    if (way === "from above") return way;
    return sides.size > 3 ? `${way} ${sides.size} sides` : `${way} ${listed([...sides])}`;
  }).join("; ");
}

// What is in the way, in words.
function obstacles(row) {
  if (row.state === "free") return "Nothing in the way";
  if (row.state === "unreached") return "No base pose and arm configuration reach it without touching furniture";
  const part = { hand: "hand", arm: "arm", "way out": "on the way out", "on it": "stands on it" };
  const names = row.by.map(([name, by]) => (row.state === "furniture" ? name : `${shortName(name)} (${part[by]})`));
  return row.state === "furniture" ? `The hand touches ${listed(names)}` : listed(names);
}

// What it costs to take the object so.
function costOf(row) {
  if (row.state === "free") return "0 to move";
  if (row.state !== "blocked") return "never";
  return row.moves === null ? "no order" : `${row.proved ? "" : "≤ "}${row.moves} to move`;
}

class Why {
  constructor(recording, changed) {
    this.recording = recording;
    this.changed = changed;
    this.chosen = null; // {name} of an object, or {point} of a place
    this.row = 0;
    this.key = "";
    this.root = document.getElementById("why");
    this.part = (name) => this.root.querySelector(`[data-part=${name}]`);
    this.part("object").onchange = (event) => this.choose(event.target.value ? { name: event.target.value } : null);
  }

  // Show the answer for an object, a place, or nothing; `null` is nothing.
  choose(chosen) {
    this.chosen = chosen;
    this.row = null;
    this.key = "";
    this.changed();
  }

  // The answers of a plan, undefined where they are unknown, and that of the chosen object.
  answers(span) {
    return this.recording.solves[Math.max(span.solve, 0)]?.why;
  }

  answer(span) {
    return this.answers(span)?.objects.find((object) => object.name === this.chosen?.name);
  }

  show(span, choice) {
    const why = this.answers(span);
    this.root.hidden = !why;
    const key = [Math.max(span.solve, 0), this.recording.solves.length, choice?.object, this.chosen && JSON.stringify(this.chosen), this.row].join("/");
    if (!why || key === this.key) return;
    this.key = key;
    const select = this.part("object");
    select.replaceChildren(new Option("an object", ""), ...why.objects.map(({ name }) => new Option(name, name)));
    select.value = this.chosen?.name || "";
    const box = this.part("answer");
    box.replaceChildren();
    if (this.chosen?.point) box.append(...this.ofPlace(this.chosen.point, choice));
    else if (this.chosen) box.append(...this.ofObject(span, why));
  }

  ofObject(span, why) {
    const answer = this.answer(span);
    if (!answer) return [element("p", "", `${this.chosen.name} is in the gripper, or not an object of this plan.`)];
    const solve = this.recording.solves[Math.max(span.solve, 0)];
    const count = (state) => answer.grasps.filter((grasp) => answer.rows[grasp[5]].state === state).length;
    const parts = [element("h3", "", answer.name), element("p", "", this.role(solve, answer, why))];
    const blocks = this.blocks(answer.name, why);
    if (blocks.length) {
      const most = blocks.length > 5 ? 4 : 5;
      const some = blocks.slice(0, most).map(([name, hits, all]) => `${hits} of ${all} grasps of ${shortName(name)}`);
      parts.push(element("p", "", `It is in the way of ${listed(blocks.length > most ? [...some, `some of ${blocks.length - most} other objects`] : some)}.`));
    }
    const fixed = count("furniture") + count("unreached");
    parts.push(element("p", "", answer.grasps.length
      ? `Before this plan: ${counted(answer.grasps.length, "grasp")} of ${why.grasps}, ${count("free")} free, ${count("blocked")} blocked by objects, ${fixed} by furniture or reach.`
      : `No grasp of ${why.grasps} fits it.`));
    if (answer.rows.length) parts.push(this.table(answer, why));
    return parts;
  }

  // What the plan does with an object, and what it could have done instead.
  role(solve, answer, why) {
    const index = solve.actions.findIndex((action) => action.kind === "pick" && action.object === answer.name);
    const cheapest = answer.rows.find((row) => row.state === "free" || (row.state === "blocked" && row.moves !== null));
    if (index < 0) {
      const leaves = solve.actions.length ? "This plan leaves it where it is. " : "";
      if (!cheapest) return `${leaves}It cannot be taken where it stands.`;
      if (cheapest.state === "free") return `${leaves}It can be taken at once.`;
      return `${leaves}To take it, ${counted(cheapest.moves, "object")} must be put aside first: ${listed(cheapest.first.map(shortName))}.`;
    }
    const grasp = answer.grasps[answer.taken];
    const moved = solve.actions.slice(0, index).filter((action) => action.kind === "place").map((action) => shortName(action.object));
    const after = moved.length ? `after ${listed([...new Set(moved)])} ${moved.length === 1 ? "is" : "are"} put aside` : "first";
    const how = grasp ? `, ${described([grasp], why.front)}` : "";
    const others = answer.rows.filter((row, number) => number !== grasp?.[5] && row.moves > 0);
    const instead = grasp && others.length && answer.rows[grasp[5]].state !== "free"
      ? ` The cheapest other way: ${counted(others[0].moves, "object")} first, ${listed(others[0].first.map(shortName))}.` : "";
    return `Action ${index + 1} takes it${how}, ${after}.${instead}`;
  }

  // Objects whose grasps an object is in the way of: [name, how many, of how many].
  blocks(name, why) {
    const found = why.objects.map((other) => {
      const hits = other.grasps.filter((grasp) => {
        const row = other.rows[grasp[5]];
        return row.state === "blocked" && row.by.some(([one]) => one === name);
      });
      return [other.name, hits.length, other.grasps.length];
    });
    return found.filter(([other, hits]) => hits && other !== name).sort((a, b) => b[1] - a[1]);
  }

  table(answer, why) {
    const list = element("ul", "ways");
    const taken = answer.grasps[answer.taken]?.[5];
    const active = this.row ?? taken ?? 0;
    answer.rows.forEach((row, index) => {
      const grasps = answer.grasps.filter((grasp) => grasp[5] === index);
      const button = element("button", `way ${row.state}`);
      const what = element("span", "what", obstacles(row));
      const first = row.moves ? `; first ${row.first.map(shortName).join(", ")}` : "";
      what.append(element("small", "", `${counted(grasps.length, "grasp")} ${described(grasps, why.front)}${first}`));
      button.append(what, element("span", "when", index === taken ? `taken, ${costOf(row)}` : costOf(row)));
      button.classList.toggle("now", index === active);
      button.onclick = () => {
        this.row = index;
        this.changed();
      };
      const item = element("li");
      item.append(button);
      list.append(item);
    });
    if (answer.rows.length <= ROWS + 1) return list;
    const more = element("details");
    more.append(element("summary", "", `${answer.rows.length - ROWS} other ways`));
    const rest = element("ul", "ways");
    rest.append(...[...list.children].slice(ROWS));
    more.append(rest);
    more.open = active >= ROWS;
    const box = element("div");
    box.append(list, more);
    return box;
  }

  ofPlace(point, choice) {
    if (!choice) return [element("p", "", "No object is put aside from here on, so no place is chosen.")];
    const away = (place) => Math.hypot(place[0] - point[0], place[1] - point[1]) + 10 * Math.abs(place[2] - point[2]);
    const nearest = (places) => places.reduce((best, place, index) => (best < 0 || away(place) < away(places[best]) ? index : best), -1);
    const heading = element("h3", "", `A place for ${choice.object}`);
    const [allowed, refused] = [nearest(choice.ordered), nearest(choice.refused)];
    const gaps = [allowed < 0 ? Infinity : away(choice.ordered[allowed]), refused < 0 ? Infinity : away(choice.refused[refused])];
    const isChosen = choice.chosen && Math.hypot(choice.chosen[0] - point[0], choice.chosen[1] - point[1]) < choice.radius;
    const parts = [heading];
    if (isChosen) parts.push(element("p", "", "The plan puts it here: the first place in the order for which a motion was found."));
    if (Math.min(...gaps) > NEAR_PLACE + choice.radius) parts.push(element("p", "", "No candidate place is near here."));
    else if (gaps[0] < gaps[1]) {
      parts.push(element("p", "", `The candidate here is allowed: number ${allowed + 1} of ${choice.ordered.length} in the order in which they are tried, those that need no drive first, the farthest first.`));
    } else parts.push(element("p", "", `The candidate here is refused: ${refusal(choice.reasons[choice.refused_by[refused]])}`));
    return parts;
  }

  // Colours of objects, by name, that the answer names.
  colours(span) {
    const answer = this.answer(span);
    const row = answer?.rows[this.row ?? answer.grasps[answer.taken]?.[5] ?? 0];
    return new Map(row?.state === "blocked" ? row.by.map(([name]) => [name, STATE_COLOURS.blocked]) : []);
  }

  // Arrows of the grasps of the chosen object, those of the chosen way opaque.
  items(span, marks) {
    const answer = this.answer(span);
    if (!answer) return [];
    const active = this.row ?? answer.grasps[answer.taken]?.[5] ?? 0;
    return answer.grasps.map(([x, y, z, yaw, pitch, row], index) => {
      const [a, b] = [(yaw * Math.PI) / 360, (pitch * Math.PI) / 360];
      const turn = [Math.cos(a) * Math.cos(b), -Math.sin(a) * Math.sin(b), Math.cos(a) * Math.sin(b), Math.sin(a) * Math.cos(b)];
      const along = [Math.cos(2 * a) * Math.cos(2 * b), Math.sin(2 * a) * Math.cos(2 * b), -Math.sin(2 * b)];
      const place = V.sub([x / 1000, y / 1000, z / 1000], V.scale(along, 0.075));
      const mesh = index === answer.taken ? marks.shapes.takenGrasp : marks.shapes.grasp;
      return { mesh, matrix: M.pose(place, turn), colour: [...STATE_COLOURS[answer.rows[row].state], row === active ? 1 : 0.4], kind: KIND.plain, lift: 0.012 };
    });
  }
}

// Why a candidate place is refused, in words.
function refusal({ standing, furniture, off, ways }) {
  const reasons = [];
  if (standing.length) reasons.push(`${listed(standing)} ${standing.length > 1 ? "stand" : "stands"} too near`);
  if (furniture.length) reasons.push(`${listed(furniture)} is too near`);
  if (off) reasons.push("it is over the edge, or reserved by the goal");
  if (ways.length) reasons.push(`it is kept clear for taking ${listed(ways)} afterwards`);
  return `${reasons.join("; ")}.`;
}
