// Starts the page; `#t=12.5` in its address begins at that time, `#play` plays, `#view=top` chooses a view.
"use strict";

const RESULTS = { success: "Success", failure: "Failure", plan: "Plan", running: "Running" };

async function start() {
  const message = await decode(document.getElementById("content").textContent);
  const { content } = message;
  const address = document.body.dataset.address;
  const recording = new Recording(message);
  const target = content.target.split("/").pop();
  let wanted = false;
  let scene, camera, panel, timeline, why;
  const draw = () => {
    wanted = false;
    const span = recording.spanAt(timeline.time);
    panel.show(span, recording.phase[recording.frameAt(timeline.time)]);
    why.show(span, choiceAt(recording, span));
    scene?.draw(timeline.time, camera, why);
    document.body.dataset.time = timeline.time.toFixed(2);
    document.body.dataset.draws = Number(document.body.dataset.draws || 0) + 1;
  };
  const changed = () => {
    if (wanted || !panel) return;
    wanted = true;
    requestAnimationFrame(draw);
  };
  timeline = new Timeline(document.getElementById("timeline"), recording, Boolean(address), changed);
  timeline.target = target;
  panel = new Panel(recording, timeline, target);
  why = new Why(recording, changed);
  const hand = new Hand(document.body.dataset.moves);
  const showResult = (result, rows) => {
    document.getElementById("result").textContent = RESULTS[result] || "";
    document.getElementById("result").className = result;
    panel.report(rows);
  };
  let built = "";
  const rebuild = () => {
    timeline.build();
    const key = `${recording.solves.length}/${recording.spans.length}`;
    if (key !== built) panel.build();
    built = key;
    changed();
  };
  const canvas = document.getElementById("scene");
  try {
    scene = new SceneView(canvas, document.getElementById("labels"), message, recording);
    camera = new Camera(canvas, changed);
    scene.layers.names ||= hand.isPlaying; // they stand in the refusals
    controls(scene, camera, changed);
    onClick(canvas, (x, y) => {
      const found = scene.under(camera.ray(x, y), timeline.time);
      if (hand.isPlaying) {
        hand.click(found);
        return;
      }
      why.choose(found?.object ? { name: found.object } : found?.isFixed ? { point: found.point } : null);
      if (why.chosen) document.querySelector("#why h2").scrollIntoView({ block: "nearest" });
    });
  } catch (error) {
    document.getElementById("problem").textContent = error.message;
    document.getElementById("problem").hidden = false;
  }
  const isSearch = recording.solves.some((solve) => solve.beliefs.length);
  for (const part of document.querySelectorAll("[data-of]")) part.hidden = (part.dataset.of === "search") !== isSearch;
  showResult(content.result, content.rows);
  rebuild();
  new ResizeObserver(changed).observe(canvas);
  if (address) listen(address, recording, rebuild, showResult, hand);
  const wishes = new URLSearchParams(location.hash.slice(1));
  if (wishes.has("view") && wishes.get("view") in VIEWS) camera?.show(wishes.get("view"));
  if (wishes.has("t")) timeline.seek(Number(wishes.get("t")) || 0);
  if (wishes.has("play")) timeline.toggle(true);
  document.body.dataset.state = "ready";
}

// Buttons of views and boxes of layers.
function controls(scene, camera, changed) {
  for (const button of document.querySelectorAll("[data-view]")) button.onclick = () => camera.show(button.dataset.view);
  for (const box of document.querySelectorAll("[data-layer]")) {
    box.checked = scene.layers[box.dataset.layer];
    box.onchange = () => {
      scene.layers[box.dataset.layer] = box.checked;
      changed();
    };
  }
}

// Take in what the server of a running episode sends.
function listen(address, recording, rebuild, showResult, hand) {
  const events = new EventSource(address);
  let turn = Promise.resolve();
  events.onmessage = (event) => {
    turn = turn.then(async () => {
      const message = await decode(event.data);
      recording.add(message);
      if (message.content.play) hand.show(message.content.play);
      if (message.content.rows) showResult(message.content.result, message.content.rows);
      if (message.content.result && message.content.result !== "running") events.close();
      rebuild();
    });
  };
}

window.addEventListener("error", (event) => (document.body.dataset.error = event.message));
window.addEventListener("unhandledrejection", (event) => (document.body.dataset.error = String(event.reason)));
start();
