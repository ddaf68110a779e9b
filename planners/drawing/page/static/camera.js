// A camera on a sphere around a point: drag to turn, right button or shift to move, wheel or two fingers to zoom.
"use strict";

const VIEWS = {
  overview: { centre: [-0.3, 0, 0.55], distance: 3.9, azimuth: 252, elevation: 36 },
  table: { centre: [-0.02, 0, 0.74], distance: 2.0, azimuth: 264, elevation: 52 },
  top: { centre: [-0.25, 0, 0.74], distance: 3.4, azimuth: 180, elevation: 89.5 },
};
const FIELD = (35 * Math.PI) / 180;

class Camera {
  constructor(canvas, changed) {
    this.canvas = canvas;
    this.changed = changed;
    this.pointers = new Map();
    this.show("overview");
    canvas.addEventListener("pointerdown", (event) => {
      canvas.setPointerCapture(event.pointerId);
      this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    });
    for (const name of ["pointerup", "pointercancel"])
      canvas.addEventListener(name, (event) => this.pointers.delete(event.pointerId));
    canvas.addEventListener("pointermove", (event) => this.drag(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("wheel", (event) => {
      event.preventDefault();
      this.zoom(Math.exp(event.deltaY * 0.001));
    }, { passive: false });
  }

  show(name) {
    Object.assign(this, structuredClone(VIEWS[name]));
    this.changed?.();
  }

  zoom(factor) {
    this.distance = Math.min(Math.max(this.distance * factor, 0.3), 9);
    this.changed();
  }

  drag(event) {
    const before = this.pointers.get(event.pointerId);
    if (!before) return;
    const gap = () => {
      const [a, b] = [...this.pointers.values()];
      return Math.hypot(a[0] - b[0], a[1] - b[1]);
    };
    const two = this.pointers.size === 2;
    const old = two ? gap() : 0;
    this.pointers.set(event.pointerId, [event.clientX, event.clientY]);
    const [dx, dy] = [event.clientX - before[0], event.clientY - before[1]];
    if (two) this.zoom(old / gap());
    if (two || event.buttons & 6 || event.shiftKey) {
      const { right, up } = this.axes();
      const step = (this.distance * FIELD) / this.canvas.clientHeight / (two ? 2 : 1);
      this.centre = V.add(this.centre, V.add(V.scale(right, -dx * step), V.scale(up, dy * step)));
    } else {
      this.azimuth -= dx * 0.35;
      this.elevation = Math.min(Math.max(this.elevation + dy * 0.3, -5), 89.5);
    }
    this.changed();
  }

  get eye() {
    const [a, e] = [(this.azimuth * Math.PI) / 180, (this.elevation * Math.PI) / 180];
    const away = [Math.cos(e) * Math.cos(a), Math.cos(e) * Math.sin(a), Math.sin(e)];
    return V.add(this.centre, V.scale(away, this.distance));
  }

  axes() {
    const back = V.unit(V.sub(this.eye, this.centre));
    const right = V.unit(V.cross([0, 0, 1], back));
    return { right, up: V.cross(back, right) };
  }

  // Of the canvas, and the vertical angle that is seen. A high, narrow window shows as much as a wide one.
  get shape() {
    const aspect = this.canvas.width / this.canvas.height;
    return { aspect, angle: aspect < 1.2 ? 2 * Math.atan((Math.tan(FIELD / 2) * 1.2) / aspect) : FIELD };
  }

  // The ray from the eye through a place of the canvas, in its pixels.
  ray(x, y) {
    const { aspect, angle } = this.shape;
    const { right, up } = this.axes();
    const high = Math.tan(angle / 2);
    const [across, above] = [(2 * x) / this.canvas.clientWidth - 1, 1 - (2 * y) / this.canvas.clientHeight];
    const ahead = V.unit(V.sub(this.centre, this.eye));
    const along = V.add(ahead, V.add(V.scale(right, across * high * aspect), V.scale(up, above * high)));
    return { eye: this.eye, along: V.unit(along) };
  }

  matrix() {
    const { aspect, angle } = this.shape;
    return M.multiply(M.perspective(angle, aspect, 0.05, 40), M.lookAt(this.eye, this.centre, [0, 0, 1]));
  }
}
