// Everything that takes time: files are read and volumes are traced here, while the page stays responsive.

import init, { Kind, VolumeFile } from "./vdb_web.js";
import { Renderer } from "./renderer.js";

const KINDS = { voxels: Kind.Voxels, smooth: Kind.Smooth, fog: Kind.Fog };
const nameOf = (kind) => Object.keys(KINDS).find((name) => KINDS[name] === kind);
// Frames that are averaged when nothing moves, on a GPU and in software.
const FRAMES = { gpu: 64, software: 24 };
// Milliseconds of a frame while something moves, and the least part of the pixels along each axis.
const MOVING_TIME = 45;
const LEAST_SCALE = 0.125;

let wasm = null;
let renderer = null;
// Whether nothing works any more: what failed first has been reported, and what fails because of it is not.
let isDead = false;
// The file that is open, and the number that the page has given it.
let file = null;
let fileNumber = null;
let volume = null;
// What the page needs to know about the volume.
let shown = null;
// What is to be seen. Each change makes a new version.
const wanted = { version: 0, size: [0, 0], camera: null, isMoving: false, look: null };
let wake = () => {};
// The frame being traced.
let tracing = Promise.resolve();
// What is on the canvas: its version, the frames in it after the first, and the sizes of these and of the canvas.
let drawn = { version: -1, frames: 0, size: [0, 0], canvas: [0, 0] };

function report(type, data = {}, transfer = []) {
  postMessage({ type, ...data }, transfer);
}

function change(fields) {
  Object.assign(wanted, fields, { version: wanted.version + 1 });
  wake();
}

// `request` goes back to the page as it came.
async function open({ request, url, bytes }) {
  if (url) {
    const response = await fetch(url);
    if (!response.ok) throw new Error(`${url}: ${response.status} ${response.statusText}`);
    bytes = await response.arrayBuffer();
  }
  const read = VolumeFile.open(new Uint8Array(bytes));
  file?.free();
  file = read;
  fileNumber = request.number;
  const grids = file.grids().map((grid) => ({ name: grid.name, kind: nameOf(grid.kind), isFixed: grid.isFixed }));
  report("opened", { request, grids, main: file.mainGrid(), notes: file.notes(), bytes: bytes.byteLength });
}

// Shows a grid of the file with a number. `subject` goes back to the page as it came.
async function show({ number, grid, kind, zIsUp, subject }) {
  // Another file has been opened since, for which the page will ask, too.
  if (number !== fileNumber) return;
  const packed = file.pack(grid, KINDS[kind], renderer.largestVolume);
  packed.setUp(zIsUp);
  const pipeline = await renderer.compile(kind, packed.isWide());
  volume?.free();
  volume = null;
  change({});
  // Its buffers are about to be replaced.
  await tracing;
  const header = packed.header();
  // A view of memory, which lasts until the module allocates more.
  const words = new Uint32Array(wasm.memory.buffer, packed.wordsAt(), packed.wordCount());
  renderer.show(pipeline, header, words);
  volume = packed;
  shown = { kind, zIsUp, subject };
  reportVolume();
}

function reportVolume() {
  // The camera and the look that belong to it come as an answer.
  change({ camera: null });
  report("volume", {
    ...shown,
    bounds: [...volume.bounds()],
    majorant: volume.majorant(),
    bytes: 4 * volume.wordCount(),
    loaded: performance.getEntriesByType("resource").map(({ name, encodedBodySize }) => [name, encodedBodySize]),
  });
}

function turn({ zIsUp }) {
  if (!volume) return;
  volume.setUp(zIsUp);
  shown.zIsUp = zIsUp;
  reportVolume();
}

function pick({ x, y }) {
  if (!volume || !wanted.camera) return;
  // Where most of the light of a fog has been scattered.
  const hit = volume.pick(wanted.camera, x, y, 1 / Math.max(wanted.look.extinction, 1e-30));
  report("pick", { voxel: hit ? [hit.x, hit.y, hit.z] : null });
  hit?.free();
}

// The picture as it is, as a PNG file.
async function pictureFile() {
  await tracing;
  if (drawn.size[0] === 0) throw new Error("There is no picture yet.");
  const image = await renderer.picture();
  const canvas = new OffscreenCanvas(image.width, image.height);
  canvas.getContext("2d").putImageData(image, 0, 0);
  return canvas.convertToBlob({ type: "image/png" });
}

// Answers with a file, or with the reason why there is none.
async function save() {
  const result = await pictureFile().then((file) => ({ file }), ({ message }) => ({ why: message }));
  report("saved", result);
}

const handlers = {
  start,
  open,
  show,
  pick,
  save,
  look: ({ look }) => change({ look }),
  camera: ({ camera, isMoving }) => change({ camera, isMoving }),
  size: ({ size }) => change({ size, camera: null }),
  up: turn,
};

async function start({ canvas }) {
  // Both take a while and neither needs the other.
  [wasm, renderer] = await Promise.all([
    init({ module_or_path: new URL("vdb_web_bg.wasm", import.meta.url) }),
    Renderer.create(canvas, { lost, failed: fail }),
  ]);
  report("started", {
    adapter: renderer.adapter,
    isSoftware: renderer.isSoftware,
    hasTimestamps: renderer.hasTimestamps,
  });
  draw().catch(fail);
}

function fail(error) {
  if (isDead) return;
  // `vdb_core` never panics because of a file, so the page must be out of memory.
  const isOutOfMemory = error instanceof WebAssembly.RuntimeError;
  const message = isOutOfMemory ? "The file needs more memory than a page can have." : error.message;
  isDead = !renderer || isOutOfMemory;
  report("failed", { message, isFatal: isDead });
}

function lost(why) {
  isDead = true;
  report("lost", { why });
}

function isReady() {
  return volume && wanted.camera && wanted.look && wanted.size[0] > 0;
}

// The size of a frame, in rays.
function traceSize() {
  const pixels = wanted.size[0] * wanted.size[1];
  const time = renderer.estimate(pixels);
  const fitting = wanted.isMoving && time !== null ? Math.sqrt(MOVING_TIME / time) : 1;
  // What the GPU's buffers have room for: less than the pixels of large screens.
  const most = Math.sqrt(renderer.mostRays / pixels);
  const scale = Math.min(Math.max(fitting, LEAST_SCALE), most, 1);
  return wanted.size.map((size) => Math.max(Math.floor(scale * size), 1));
}

// Draws whatever is wanted, again and again, and rests when it is finished.
async function draw() {
  const most = renderer.isSoftware ? FRAMES.software : FRAMES.gpu;
  while (!isDead) {
    const isNew = isReady() && drawn.version !== wanted.version;
    const isUnfinished = isReady() && !wanted.isMoving && !wanted.look.showsData && drawn.frames < most;
    if (!isNew && !isUnfinished) {
      await new Promise((resolve) => (wake = resolve));
      continue;
    }
    const { version, isMoving, look } = wanted;
    const frame = isNew ? 0 : drawn.frames + 1;
    const size = isNew ? traceSize() : drawn.size;
    try {
      const time = await drawFrame(frame, size);
      if (time === null) continue;
      const isSettled = wanted.version === version && !isMoving && (look.showsData || frame === most);
      report("frame", { time, size, frame, isSettled });
    } catch (error) {
      fail(error);
      drawn = { ...drawn, version, frames: most };
    }
    // Messages come between frames.
    await new Promise((resolve) => setTimeout(resolve));
  }
}

// Draws a frame of what is wanted. Returns its milliseconds, or null if nobody wants it any more.
async function drawFrame(frame, size) {
  const { version, isMoving, look, camera, size: canvas } = wanted;
  // Frames while something moves are short, and without them nothing would be seen to move.
  const isStale = () => !isMoving && wanted.version !== version;
  const trace = renderer.trace(volume.view(camera), look, frame, size, isStale);
  // What else waits for it does not need to know that it failed.
  tracing = trace.catch(() => {});
  const time = await trace;
  if (time === null || !volume) return null;
  if (canvas.some((pixels, i) => pixels !== drawn.canvas[i])) renderer.resize(...canvas);
  await renderer.present(size, frame, look.showsData);
  drawn = { version, frames: frame, size, canvas };
  return time;
}

// One after another, because opening a file and showing it take turns with others.
let queue = Promise.resolve();
const LONG = ["start", "open", "show", "up", "save"];
onmessage = ({ data }) => {
  const handle = async () => (isDead ? null : handlers[data.type](data));
  if (LONG.includes(data.type)) queue = queue.then(handle).catch(fail);
  else handle().catch(fail);
};
