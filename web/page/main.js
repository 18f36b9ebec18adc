// The page: settings, files and messages. The worker reads files and draws; see `worker.js` for what it is told and
// what it reports.

import { Orbit } from "./orbit.js";

const $ = (id) => document.getElementById(id);
const query = new URLSearchParams(location.search);
// Files larger than this are refused before they are read into memory.
const LARGEST_FILE = 2 ** 30;
// Frames that scripts can ask for.
const MOST_FRAMES = 200;
// What the picture shows as data.
const DATA = { voxels: "Colour by voxel", smooth: "Show normals", fog: "Show transmittance" };

const canvas = $("picture");
const worker = new Worker("worker.js", { type: "module" });

let models = [];
// What is open: its title, its grids, and for a bundled model the file of each kind.
let opened = null;
let volume = null;
let kind = null;
let loaded = 0;
// For scripts: the latest frames, whether the picture is finished, and calls that wait until it is.
let frames = [];
let isSettled = false;
let waiting = [];
// Calls that wait for a picture.
let saving = [];

const orbit = new Orbit(canvas, sendCamera);

// Messages

function say(text) {
  $("status").textContent = text;
}

function showMessage(title, text, button, action) {
  say("");
  $("message-title").textContent = title;
  $("message-text").textContent = text;
  $("message-button").textContent = button;
  $("message-button").onclick = () => {
    $("message").hidden = true;
    action();
  };
  $("message").hidden = false;
  $("message-button").focus();
}

function failed({ message, isFatal }) {
  if (isFatal) showMessage("The demo cannot run", message, "Reload", () => location.reload());
  else showMessage("This cannot be shown", message, "Close", () => canvas.focus());
  waiting.forEach(({ reject }) => reject(new Error(message)));
  waiting = [];
}

// What the worker is told

function send(type, data = {}, transfer = []) {
  isSettled &&= type === "pick" || type === "save";
  worker.postMessage({ type, ...data }, transfer);
}

function sendSize() {
  const scale = Math.min(devicePixelRatio, 2);
  const size = [canvas.clientWidth, canvas.clientHeight].map((pixels) => Math.max(Math.round(scale * pixels), 1));
  send("size", { size });
  sendCamera();
}

function aspect() {
  return canvas.clientWidth / Math.max(canvas.clientHeight, 1);
}

function sendCamera() {
  if (volume) send("camera", { camera: orbit.numbers(aspect()), isMoving: orbit.isMoving });
}

function linear(hex) {
  const parts = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
  return parts.map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
}

// Fog is white, or nearly; its colour is what it does not absorb.
function look() {
  const [azimuth, elevation] = ["azimuth", "elevation"].map((id) => ($(id).valueAsNumber * Math.PI) / 180);
  const [sin, cos] = [Math.sin(elevation), Math.cos(elevation)];
  return {
    toSun: [cos * Math.sin(azimuth), sin, cos * Math.cos(azimuth)],
    color: kind === "fog" ? [0.97, 0.97, 0.97] : linear($("color").value),
    // The slider is a power of ten: the optical depth along the radius at the largest density.
    extinction: 10 ** $("density").valueAsNumber / Math.max(orbit.radius * volume.majorant, 1e-30),
    showsData: $("data").checked,
  };
}

function sendLook() {
  if (volume) send("look", { look: look() });
}

// Models, files, grids and kinds

function openModel(name, wantedKind) {
  const model = models.find((own) => own.name === name) ?? models[0];
  const kinds = Object.keys(model.files);
  $("model").value = model.name;
  opened = { title: model.title, files: model.files, isNew: true };
  chooseKind(kinds.includes(wantedKind) ? wantedKind : kinds[0]);
}

async function openFile(file) {
  if (file.size > LARGEST_FILE) {
    const mebibytes = Math.round(file.size / 2 ** 20);
    failed({ message: `${file.name} has ${mebibytes} MiB; this page reads up to ${LARGEST_FILE / 2 ** 20} MiB.` });
    return;
  }
  say(`Reading ${file.name} …`);
  let bytes;
  try {
    bytes = await file.arrayBuffer();
  } catch (error) {
    failed({ message: `${file.name} cannot be read: ${error.message}` });
    return;
  }
  opened = { title: file.name, files: null, isNew: true };
  send("open", { bytes, name: file.name }, [bytes]);
}

function chooseKind(name) {
  kind = name;
  if (opened.files) {
    say(`Loading ${opened.title} …`);
    send("open", { url: opened.files[kind], name: opened.title });
  } else {
    showVolume();
  }
}

function showVolume() {
  say("Preparing the volume …");
  const grid = opened.files ? 0 : Number($("grid").value);
  send("show", { grid, kind, zIsUp: $("z-up").checked });
}

function offerKinds(kinds) {
  for (const input of document.querySelectorAll("[name=kind]")) {
    input.disabled = !kinds.includes(input.value);
    input.checked = input.value === kind;
  }
  $("data-label").textContent = DATA[kind];
  $("density-row").hidden = kind !== "fog";
  $("color-row").hidden = kind === "fog";
}

function kindsOf({ kind, isFixed }) {
  return isFixed ? [kind] : ["voxels", "smooth"];
}

function chooseGrid(number) {
  const grid = opened.grids[number];
  kind = kindsOf(grid).includes(kind) ? kind : grid.kind;
  opened.isNew = true;
  offerKinds(kindsOf(grid));
  showVolume();
}

function nameFile(name) {
  $("model").querySelector(".own")?.remove();
  const option = new Option(name, "", true, true);
  option.className = "own";
  option.disabled = true;
  $("model").append(option);
}

// What the worker reports

const bytesText = (bytes) => (bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

const reports = {
  started({ adapter, isSoftware, hasTimestamps }) {
    $("adapter").textContent = adapter + (isSoftware ? " (software)" : "");
    $("frame-time").title = hasTimestamps ? "by the GPU’s clock" : "until the GPU has finished";
  },
  opened({ grids, main, notes, bytes, name }) {
    opened.grids = grids;
    opened.notes = notes;
    loaded = bytes;
    $("grid-row").hidden = grids.length < 2;
    if (opened.files) {
      offerKinds(Object.keys(opened.files));
      showVolume();
      return;
    }
    nameFile(name);
    $("grid").replaceChildren(...grids.map((grid, i) => new Option(grid.name || "(no name)", i, false, i === main)));
    chooseGrid(main);
  },
  volume(data) {
    volume = data;
    if (opened.isNew) orbit.frame(data.bounds.slice(0, 3), data.bounds.slice(3), kind === "fog" ? 0.14 : 0.3);
    opened.isNew = false;
    say(opened.notes.length > 0 ? `Left out or changed: ${opened.notes.join("; ")}` : "");
    $("volume-bytes").textContent = bytesText(data.bytes);
    const own = performance.getEntriesByType("resource").map(({ name, encodedBodySize }) => [name, encodedBodySize]);
    const files = new Map([...own, ...data.loaded].filter(([name]) => !name.includes("/models/")));
    const [page] = performance.getEntriesByType("navigation");
    const code = [...files.values()].reduce((sum, bytes) => sum + bytes, page?.encodedBodySize ?? 0);
    $("loaded-bytes").textContent = `${bytesText(code)} page, ${bytesText(loaded)} volume`;
    sendLook();
    sendCamera();
  },
  frame(data) {
    const { time, size, frame } = data;
    ({ isSettled } = data);
    const rate = (size[0] * size[1]) / time / 1e3;
    $("frame-time").textContent = `${time.toFixed(time < 10 ? 2 : 0)} ms`;
    $("ray-rate").textContent = `${rate.toFixed(rate < 10 ? 2 : 0)} million/s`;
    $("picture-size").textContent = `${size[0]} × ${size[1]}, ${frame + 1} frames`;
    frames = [...frames.slice(1 - MOST_FRAMES), { ...data, at: performance.now() }];
    if (!isSettled) return;
    waiting.forEach(({ resolve }) => resolve());
    waiting = [];
  },
  pick({ voxel }) {
    const name = kind === "voxels" ? "voxel " : "";
    $("pick").textContent = voxel ? `${name}${voxel.join(", ")}`.replaceAll("-", "−") : "–";
  },
  saved({ file }) {
    saving.forEach((resolve) => resolve(file));
    saving = [];
  },
  failed,
  lost({ why }) {
    const text = `The graphics device is gone: ${why}.`;
    showMessage("The picture has stopped", text, "Reload", () => location.reload());
  },
};
worker.onmessage = ({ data }) => reports[data.type](data);
worker.onerror = (event) => {
  const message = event.message ?? "The page’s worker could not be started. A current browser may help.";
  failed({ message, isFatal: true });
};

// The picture as a PNG file.
function picture() {
  send("save");
  return new Promise((resolve) => saving.push(resolve));
}

async function download() {
  const link = document.createElement("a");
  link.href = URL.createObjectURL(await picture());
  link.download = "volume.png";
  link.click();
  URL.revokeObjectURL(link.href);
}

// Input

function listen() {
  $("save").addEventListener("click", download);
  new ResizeObserver(sendSize).observe(canvas);
  $("model").addEventListener("change", () => openModel($("model").value));
  $("grid").addEventListener("change", () => chooseGrid(Number($("grid").value)));
  $("kinds").addEventListener("change", ({ target }) => {
    chooseKind(target.value);
    offerKinds(opened.files ? Object.keys(opened.files) : kindsOf(opened.grids[Number($("grid").value)]));
  });
  for (const id of ["azimuth", "elevation", "color", "density", "data"]) $(id).addEventListener("input", sendLook);
  $("z-up").addEventListener("change", () => {
    if (opened) opened.isNew = true;
    send("up", { zIsUp: $("z-up").checked });
  });
  $("open").addEventListener("click", () => $("file").click());
  $("file").addEventListener("change", () => {
    const [file] = $("file").files;
    if (file) openFile(file);
    $("file").value = "";
  });
  canvas.addEventListener("pointermove", ({ offsetX, offsetY, buttons }) => {
    if (!volume || buttons) return;
    const [x, y] = [offsetX / canvas.clientWidth, offsetY / canvas.clientHeight];
    send("pick", { x: 2 * x - 1, y: 1 - 2 * y });
  });
  canvas.addEventListener("pointerleave", () => ($("pick").textContent = "–"));
  const isFile = (event) => event.dataTransfer?.types.includes("Files");
  addEventListener("dragover", (event) => {
    if (!isFile(event)) return;
    event.preventDefault();
    document.body.classList.add("dropping");
  });
  addEventListener("dragleave", (event) => {
    if (!event.relatedTarget) document.body.classList.remove("dropping");
  });
  addEventListener("drop", (event) => {
    document.body.classList.remove("dropping");
    if (!isFile(event)) return;
    event.preventDefault();
    const [file] = event.dataTransfer.files;
    if (file) openFile(file);
  });
}

async function start() {
  const surface = canvas.transferControlToOffscreen();
  send("start", { canvas: surface }, [surface]);
  document.body.classList.toggle("bare", query.has("bare"));
  $("data").checked = query.has("data");
  if (innerWidth < 640) document.querySelectorAll("details").forEach((details) => (details.open = false));
  say("Loading …");
  listen();
  const response = await fetch("models/models.json");
  if (!response.ok) throw new Error(`models.json: ${response.status} ${response.statusText}`);
  models = await response.json();
  $("model").replaceChildren(...models.map(({ title, name }) => new Option(title, name)));
  openModel(query.get("model"), query.get("kind"));
}

// For scripts: see web/check.py.
globalThis.demo = {
  settled: () => (isSettled ? null : new Promise((resolve, reject) => waiting.push({ resolve, reject }))),
  frames: () => frames,
  picture: async () => {
    const bytes = new Uint8Array(await (await picture()).arrayBuffer());
    return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  },
  state: () => ({ kind, camera: orbit.numbers(aspect()), extinction: look().extinction }),
};

start().catch((error) => failed({ message: error.message, isFatal: true }));
