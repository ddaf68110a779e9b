// Moves of a person: click an object to take it, then a place to put it. The page's server plans and moves the arm.
"use strict";

class Hand {
  constructor(address) {
    this.address = address;
    this.state = null;
    this.waits = false;
    this.root = document.getElementById("hand");
    this.part = (name) => this.root.querySelector(`[data-part=${name}]`);
    this.root.hidden = !address;
    if (address) document.getElementById("hint").textContent = "click: take or put · drag: turn · right drag: move · wheel: zoom";
    this.part("form").onsubmit = (event) => {
      event.preventDefault();
      this.send({ take: this.part("objects").value });
    };
    this.part("stop").onclick = () => (this.state?.over ? location.reload() : this.send({ stop: true }));
  }

  get isPlaying() {
    return Boolean(this.address) && !this.state?.over;
  }

  // What a click in the scene means: to put down what is held, else to take what was clicked.
  click(found) {
    if (!this.state || this.waits || this.state.busy) return;
    if (this.state.held && found?.isFixed) this.send({ put: found.point.map((value) => Number(value.toFixed(4))) });
    else if (found?.object) this.send({ take: found.object });
  }

  async send(move) {
    if (this.waits) return;
    this.waits = true;
    this.busy("Planning …");
    let answer;
    try {
      const reply = await fetch(this.address, { method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(move) });
      answer = await reply.json();
    } catch {
      answer = { refused: "The command has ended." };
    }
    this.waits = false;
    this.part("refused").textContent = answer.refused || "";
    if (answer.refused) this.busy("");
  }

  busy(text) {
    document.body.toggleAttribute("data-busy", Boolean(text));
    if (text) {
      this.part("now").textContent = text;
      this.part("refused").textContent = "";
    } else this.tell();
  }

  // Show the state of the game.
  show(state) {
    this.state = state;
    document.body.toggleAttribute("data-busy", state.busy);
    const least = state.minimum === null ? "the minimum is not proved" : `proved minimum ${state.minimum}`;
    this.part("count").textContent = `${state.moves} moved · ${least}`;
    const select = this.part("objects");
    select.replaceChildren(...state.objects.map((name) => new Option(name, name)));
    select.value = state.target;
    this.part("stop").textContent = state.over ? "Next scene" : "Give up";
    this.part("stop").hidden = state.over && !state.next;
    this.tell();
  }

  tell() {
    const { state } = this;
    if (!state) return;
    const target = shortName(state.target);
    const words = state.over ? state.over
      : state.busy ? state.busy
      : state.held ? `${state.happened}Click a place for ${shortName(state.held)}.`
      : `${state.happened}Click the object to take. The aim: hold up ${target}, the red one, with as few others moved as possible.`;
    this.part("now").textContent = words;
  }
}
