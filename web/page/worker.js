// Everything that takes time: files are read and volumes are traced here, while the page stays responsive.

import init, { Kind, VolumeFile } from "./vdb_web.js";
import { Refused, Renderer } from "./renderer.js";

const KINDS = { voxels: Kind.Voxels, smooth: Kind.Smooth, fog: Kind.Fog };
const nameOf = (kind) => Object.keys(KINDS).find((name) => KINDS[name] === kind);
// Frames that are averaged when nothing moves, on a GPU and in software.
const FRAMES = { gpu: 64, software: 24 };
// Milliseconds of a frame while something moves, and the least part of the pixels along each axis.
const MOVING_TIME = 45;
const LEAST_SCALE = 0.125;

let wasm = null;
let renderer = null;
let file = null;
let volume = null;
// What is to be seen. Each change makes a new version.
const wanted = { version: 0, size: [0, 0], camera: null, isMoving: false, look: null };
let wake = () => {};
// The frame being traced.
let tracing = Promise.resolve();

function report(type, data = {}, transfer = []) {
  postMessage({ type, ...data }, transfer);
}

function change(fields) {
  Object.assign(wanted, fields, { version: wanted.version + 1 });
  wake();
}

async function open({ url, bytes, name }) {
  if (url) {
    const response = await fetch(url);
    if (!response.ok) throw new Refused(`${url}: ${response.status} ${response.statusText}`);
    bytes = await response.arrayBuffer();
  }
  const read = VolumeFile.open(new Uint8Array(bytes));
  file?.free();
  file = read;
  const grids = file.grids().map((grid) => ({ name: grid.name, kind: nameOf(grid.kind), isFixed: grid.isFixed }));
  report("opened", { name, grids, main: file.mainGrid(), notes: file.notes(), bytes: bytes.byteLength });
}

async function show({ grid, kind, zIsUp }) {
  const packed = file.pack(grid, KINDS[kind], renderer.largestVolume);
  volume?.free();
  volume = null;
  change({});
  // Its buffers are about to be replaced.
  await tracing;
  const words = new Uint32Array(wasm.memory.buffer, packed.wordsAt(), packed.wordCount());
  await renderer.show(kind, packed.isWide(), packed.header(), words);
  packed.setUp(zIsUp);
  volume = packed;
  reportVolume();
}

function reportVolume() {
  // The camera and the look that belong to it come as an answer.
  change({ camera: null });
  report("volume", {
    bounds: [...volume.bounds()],
    majorant: volume.majorant(),
    bytes: 4 * volume.wordCount(),
    loaded: performance.getEntriesByType("resource").map(({ name, encodedBodySize }) => [name, encodedBodySize]),
  });
}

function pick({ x, y }) {
  if (!volume || !wanted.camera) return;
  // Where most of the light of a fog has been scattered.
  const hit = volume.pick(wanted.camera, x, y, 1 / Math.max(wanted.look.extinction, 1e-30));
  report("pick", { voxel: hit ? [hit.x, hit.y, hit.z] : null });
  hit?.free();
}

// The picture as it is, as a PNG file.
async function save() {
  if (!isReady()) return;
  await tracing;
  const image = await renderer.picture();
  const canvas = new OffscreenCanvas(image.width, image.height);
  canvas.getContext("2d").putImageData(image, 0, 0);
  report("saved", { file: await canvas.convertToBlob({ type: "image/png" }) });
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
  up: ({ zIsUp }) => {
    volume?.setUp(zIsUp);
    if (volume) reportVolume();
  },
};

async function start({ canvas }) {
  // Both take a while and neither needs the other.
  [wasm, renderer] = await Promise.all([
    init({ module_or_path: new URL("vdb_web_bg.wasm", import.meta.url) }),
    Renderer.create(canvas, (why) => report("lost", { why })),
  ]);
  report("started", {
    adapter: renderer.adapter,
    isSoftware: renderer.isSoftware,
    hasTimestamps: renderer.hasTimestamps,
  });
  draw().catch(fail);
}

function fail(error) {
  // `vdb_core` panics at nothing in a file, so it is memory that a page has no more of.
  const isOutOfMemory = error instanceof WebAssembly.RuntimeError;
  const message = isOutOfMemory ? "The file takes more memory than a page has." : error.message;
  const isFatal = !renderer || isOutOfMemory;
  report("failed", { message, isFatal });
}

function isReady() {
  return volume && wanted.camera && wanted.look && wanted.size[0] > 0;
}

// The size of a frame, in rays.
function traceSize() {
  const pixels = wanted.size[0] * wanted.size[1];
  const time = renderer.estimate(pixels);
  const fitting = wanted.isMoving && time !== null ? Math.sqrt(MOVING_TIME / time) : 1;
  const scale = Math.min(Math.max(fitting, LEAST_SCALE), 1);
  return wanted.size.map((size) => Math.max(Math.round(scale * size), 1));
}

// Draws whatever is wanted, again and again, and rests when it is finished.
async function draw() {
  const most = renderer.isSoftware ? FRAMES.software : FRAMES.gpu;
  let drawn = { version: -1, frames: 0, size: [0, 0], canvas: [0, 0] };
  for (;;) {
    const isNew = isReady() && drawn.version !== wanted.version;
    const isUnfinished = isReady() && !wanted.isMoving && !wanted.look.showsData && drawn.frames < most;
    if (!isNew && !isUnfinished) {
      await new Promise((resolve) => (wake = resolve));
      continue;
    }
    const { version, isMoving, look, camera } = wanted;
    const canvas = wanted.size;
    const frame = isNew ? 0 : drawn.frames + 1;
    const size = isNew ? traceSize() : drawn.size;
    // Frames while something moves are short, and without them nothing would be seen to move.
    const isStale = () => !isMoving && wanted.version !== version;
    try {
      tracing = renderer.trace(volume.view(camera), look, frame, size, isStale);
    } catch (error) {
      fail(error);
      drawn = { version, frames: most, size, canvas };
      continue;
    }
    const time = await tracing;
    if (time === null || !volume) continue;
    if (canvas.some((pixels, i) => pixels !== drawn.canvas[i])) renderer.resize(...canvas);
    await renderer.present(size, frame, look.showsData);
    drawn = { version, frames: frame, size, canvas };
    const isSettled = wanted.version === version && !isMoving && (look.showsData || frame === most);
    report("frame", { time, size, frame, isSettled });
    // Messages come between frames.
    await new Promise((resolve) => setTimeout(resolve));
  }
}

// One after another, because opening a file and showing it take turns with others.
let queue = Promise.resolve();
const LONG = ["start", "open", "show", "save"];
onmessage = ({ data }) => {
  const handle = () => handlers[data.type](data);
  if (LONG.includes(data.type)) queue = queue.then(handle).catch(fail);
  else handle();
};
