// The side panel: actions to click on, replanning, the report.
"use strict";

// An action in words.
function describe(action) {
  if (action.text) return action.text[0].toUpperCase() + action.text.slice(1);
  if (action.kind === "drive") return "Drive";
  if (action.kind === "pick") return `Pick up ${action.object}`;
  if (action.kind === "place") return `Put ${action.object} aside${action.because ? `, it obstructs ${action.because}` : ""}`;
  return `${action.name} ${action.object}`;
}

function element(tag, className, text) {
  const made = document.createElement(tag);
  if (className) made.className = className;
  if (text !== undefined) made.textContent = text;
  return made;
}

class Panel {
  constructor(recording, timeline, target) {
    this.recording = recording;
    this.timeline = timeline;
    this.target = target;
    this.rows = [];
    this.shown = "";
  }

  build() {
    const list = document.getElementById("plans");
    list.replaceChildren();
    this.rows = [];
    this.recording.solves.forEach((solve, index) => {
      list.append(this.heading(solve, index));
      if (!solve.actions.length) list.append(element("p", "failure", solve.summary));
      const actions = element("ol", "actions");
      solve.actions.forEach((action, number) => actions.append(this.row(action, index, number)));
      list.append(actions);
      if (solve.history.length) list.append(this.history(solve.history));
    });
    this.shown = "";
  }

  heading(solve, index) {
    const reason = this.recording.notes.filter((note) => note.time <= solve.time + 1e-6).pop();
    const after = index && reason ? ` after “${reason.text}”` : "";
    const when = solve.time ? ` at ${solve.time.toFixed(1)} s` : "";
    if (solve.beliefs.length) return element("h3", "", "Search");
    const many = this.recording.solves.length > 1;
    const count = solve.clearances ? `, ${solve.clearances.length} to put aside` : "";
    const by = solve.strategy ? ` by ${solve.strategy}` : "";
    return element("h3", "", `${!solve.actions.length ? "No plan" : many ? `Plan ${index + 1}` : "Plan"}${by}${count}${when}${after}`);
  }

  row(action, solve, number) {
    const row = element("button", `action ${action.object === this.target ? "target" : action.kind}`);
    const spans = this.recording.spans.filter((span) => span.solve === solve && span.action === number);
    const text = element("span", "what", describe(action));
    if (!action.text) text.title = `${action.name.toUpperCase()} (${action.args.join(" ").toUpperCase()})`;
    row.append(element("span", "number", String(number + 1)), text);
    // Without a span: the robot already stood where this drive ends, or the plan ended before.
    const isPassed = this.recording.spans.some((span) => span.solve === solve && span.action > number);
    const without = isPassed ? "nothing to do" : this.timeline.follows ? "" : "not executed";
    row.append(element("span", "when", spans.length ? `${spans[0].start.toFixed(1)} s` : without));
    row.disabled = !spans.length;
    if (spans.length) row.onclick = () => this.timeline.seek(spans[0].start);
    this.rows.push({ row, solve, number });
    const item = element("li");
    item.append(row);
    return item;
  }

  // Task plans that motion planning refuted, as in Fig. 11 of Lee & Kim 2019.
  history(turns) {
    const box = element("details");
    box.append(element("summary", "", `${turns.length} task plans refuted before this plan`));
    turns.forEach((turn, index) => {
      box.append(element("h4", "", `Task plan ${index + 1}`));
      const lines = element("ul", "turn");
      turn.plan.forEach((action, number) => {
        const state = number < turn.verified ? "verified" : number === turn.verified ? "refuted" : "open";
        lines.append(element("li", state, action));
      });
      if (turn.reason) lines.append(element("li", "reason", turn.reason));
      for (const fact of turn.facts.slice(0, 8)) lines.append(element("li", "fact", `learnt: ${fact}`));
      if (turn.facts.length > 8) lines.append(element("li", "fact", `and ${turn.facts.length - 8} more facts`));
      box.append(lines);
    });
    return box;
  }

  report(rows) {
    const table = document.getElementById("report");
    table.replaceChildren();
    for (const [name, value] of rows) {
      const row = element("tr");
      row.append(element("th", "", name), element("td", "", value));
      table.append(row);
    }
  }

  // Mark the action at a span, and say above the picture what the robot does.
  show(span, phase) {
    const key = `${span.solve}/${span.action}`;
    document.getElementById("phase").textContent = phase || "";
    if (key === this.shown) return;
    this.shown = key;
    for (const { row, solve, number } of this.rows) {
      const isNow = solve === span.solve && number === span.action;
      row.classList.toggle("now", isNow);
      if (!isNow) continue;
      const top = window.scrollY;
      row.scrollIntoView({ block: "nearest" });
      window.scrollTo(0, top); // where the list is below the scene, that stays in view
    }
  }
}
