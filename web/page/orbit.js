// The camera: it orbits a point, by mouse, wheel, touch and keys.

// Vertical field of view of a window that is not taller than wide, in radians.
const FOV = 0.66;
// How far a drag across the height of the canvas turns, in radians.
const TURN = 3.4;
const STEEPEST = 1.53;
// The nearest and farthest distances, in radii of the volume.
const DISTANCES = [0.15, 40];
const MOVE_ENDS_AFTER = 160;

const clamp = (x, low, high) => Math.min(Math.max(x, low), high);

export class Orbit {
  #canvas;
  #changed;
  #pointers = new Map();
  #timer = 0;
  #home = null;

  yaw = 0;
  pitch = 0;
  distance = 1;
  target = [0, 0, 0];
  radius = 1;
  isMoving = false;

  // `changed` is called whenever the camera has changed, and when it comes to rest.
  constructor(canvas, changed) {
    this.#canvas = canvas;
    this.#changed = changed;
    canvas.addEventListener("pointerdown", (event) => this.#press(event));
    canvas.addEventListener("pointermove", (event) => this.#drag(event));
    for (const name of ["pointerup", "pointercancel"]) {
      canvas.addEventListener(name, (event) => this.#pointers.delete(event.pointerId));
    }
    canvas.addEventListener("wheel", (event) => this.#wheel(event), { passive: false });
    canvas.addEventListener("keydown", (event) => this.#key(event));
    canvas.addEventListener("contextmenu", (event) => event.preventDefault());
    canvas.addEventListener("dblclick", () => this.reset());
  }

  // Looks at a box, given by its low and its high corner, from a height as an angle.
  frame(low, high, pitch) {
    const size = [0, 1, 2].map((i) => high[i] - low[i]);
    this.radius = 0.5 * Math.hypot(...size);
    const target = [0, 1, 2].map((i) => 0.5 * (low[i] + high[i]));
    this.#home = { yaw: 0.55, pitch, distance: 2.9 * this.radius, target };
    this.reset();
  }

  reset() {
    if (!this.#home) return;
    Object.assign(this, this.#home, { target: [...this.#home.target] });
    this.#changed();
  }

  #aspect() {
    return this.#canvas.clientWidth / Math.max(this.#canvas.clientHeight, 1);
  }

  // The vertical field of view: a tall window shows as much to either side as a square one.
  #fov() {
    return 2 * Math.atan(Math.tan(FOV / 2) / Math.min(this.#aspect(), 1));
  }

  // Eight numbers, as `web/wasm/src/volume.rs` reads them.
  numbers() {
    const back = [
      Math.cos(this.pitch) * Math.sin(this.yaw),
      Math.sin(this.pitch),
      Math.cos(this.pitch) * Math.cos(this.yaw),
    ];
    const eye = this.target.map((x, i) => x + this.distance * back[i]);
    return [...eye, ...this.target, this.#fov(), this.#aspect()];
  }

  #move() {
    this.isMoving = true;
    clearTimeout(this.#timer);
    this.#timer = setTimeout(() => {
      this.isMoving = false;
      this.#changed();
    }, MOVE_ENDS_AFTER);
    this.#changed();
  }

  #turn(x, y) {
    this.yaw -= TURN * x;
    this.pitch = clamp(this.pitch + TURN * y, -STEEPEST, STEEPEST);
    this.#move();
  }

  // Moves the target with the picture, in heights of the canvas.
  #pan(x, y) {
    const scale = 2 * this.distance * Math.tan(this.#fov() / 2);
    const right = [Math.cos(this.yaw), 0, -Math.sin(this.yaw)];
    const [sin, cos] = [Math.sin(this.pitch), Math.cos(this.pitch)];
    const up = [-sin * Math.sin(this.yaw), cos, -sin * Math.cos(this.yaw)];
    this.target = this.target.map((at, i) => at + scale * (y * up[i] - x * right[i]));
    this.#move();
  }

  #zoom(factor) {
    const [nearest, farthest] = DISTANCES.map((distance) => distance * this.radius);
    this.distance = clamp(this.distance * factor, nearest, farthest);
    this.#move();
  }

  #press(event) {
    this.#canvas.setPointerCapture(event.pointerId);
    this.#pointers.set(event.pointerId, [event.clientX, event.clientY]);
  }

  #drag(event) {
    const before = this.#pointers.get(event.pointerId);
    if (!before) return;
    const height = this.#canvas.clientHeight;
    const now = [event.clientX, event.clientY];
    const [x, y] = now.map((at, i) => (at - before[i]) / height);
    this.#pointers.set(event.pointerId, now);
    if (this.#pointers.size > 1) {
      const [other] = [...this.#pointers].filter(([id]) => id !== event.pointerId).map(([, at]) => at);
      const apart = (at) => Math.max(Math.hypot(at[0] - other[0], at[1] - other[1]), 1);
      this.#zoom(apart(before) / apart(now));
      this.#pan(x / 2, y / 2);
    } else if (event.buttons & 6 || event.shiftKey) {
      this.#pan(x, y);
    } else {
      this.#turn(x, y);
    }
  }

  #wheel(event) {
    event.preventDefault();
    // In lines or pages instead of pixels.
    const pixels = event.deltaY * [1, 30, 400][event.deltaMode];
    this.#zoom(Math.exp(clamp(pixels, -240, 240) * 0.0015));
  }

  #key(event) {
    // Shortcuts of the browser.
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const step = 0.04;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    if (event.key in arrows) {
      const [x, y] = arrows[event.key].map((sign) => sign * step);
      if (event.shiftKey) this.#pan(x, y);
      else this.#turn(x, y);
    } else if (event.key === "+" || event.key === "=") {
      this.#zoom(0.9);
    } else if (event.key === "-") {
      this.#zoom(1 / 0.9);
    } else if (event.key === "Home") {
      this.reset();
    } else {
      return;
    }
    event.preventDefault();
  }
}
