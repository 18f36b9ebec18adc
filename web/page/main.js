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
// Files that the worker has been asked to open.
let requests = 0;
// What it has opened: the request for it, its grids, and the grid and the kind that are chosen.
let opened = null;
// The volume on the screen, which differs from what is chosen until that has been prepared.
let volume = null;
// Why nothing works any more.
let ended = null;
// For scripts: the latest frames, whether the picture is finished, and calls that wait until it is.
let frames = [];
let isSettled = false;
let waiting = [];
// Calls that wait for a picture: the worker answers one after another.
let saving = [];

const orbit = new Orbit(canvas, sendCamera);

// Messages

function say(text) {
  $("status").textContent = text;
}

function showMessage(title, text, button = "Close", action = () => canvas.focus()) {
  if (ended) return;
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

function rejectAll(calls, error) {
  calls.splice(0).forEach(({ reject }) => reject(error));
}

function failed({ message, isFatal }) {
  if (isFatal) {
    end("The demo cannot run", message);
    return;
  }
  showMessage("This cannot be shown", message);
  showChoices();
  rejectAll(waiting, new Error(message));
}

function end(title, text) {
  showMessage(title, text, "Reload", () => location.reload());
  ended ??= new Error(text);
  rejectAll(waiting, ended);
  rejectAll(saving, ended);
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

function sendCamera() {
  if (volume) send("camera", { camera: orbit.numbers(), isMoving: orbit.isMoving });
}

function linear(hex) {
  const parts = [1, 3, 5].map((at) => parseInt(hex.slice(at, at + 2), 16) / 255);
  return parts.map((x) => (x <= 0.04045 ? x / 12.92 : ((x + 0.055) / 1.055) ** 2.4));
}

// Fog is nearly white; its colour is its albedo.
function look() {
  const [azimuth, elevation] = ["azimuth", "elevation"].map((id) => ($(id).valueAsNumber * Math.PI) / 180);
  const [sin, cos] = [Math.sin(elevation), Math.cos(elevation)];
  return {
    toSun: [cos * Math.sin(azimuth), sin, cos * Math.cos(azimuth)],
    color: volume.kind === "fog" ? [0.97, 0.97, 0.97] : linear($("color").value),
    // The slider is a power of ten: the optical depth along the radius at the largest density.
    extinction: 10 ** $("density").valueAsNumber / Math.max(orbit.radius * volume.majorant, 1e-30),
    showsData: $("data").checked,
  };
}

function sendLook() {
  if (volume) send("look", { look: look() });
}

// Models, files, grids and kinds

// `request` comes back with what has been opened.
function open(request, source, transfer) {
  requests += 1;
  send("open", { request: { ...request, number: requests }, ...source }, transfer);
}

function openModel(model, wantedKind) {
  const kind = Object.hasOwn(model.files, wantedKind) ? wantedKind : Object.keys(model.files)[0];
  say(`Loading ${model.title} …`);
  open({ title: model.title, model, kind }, { url: model.files[kind] });
}

async function openFile(file) {
  if (ended) return;
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
  open({ title: file.name, model: null }, { bytes }, [bytes]);
}

// The ways to show a grid of the open file. A bundled model has a file for each.
function kindsOf({ kind, isFixed }) {
  if (opened.request.model) return Object.keys(opened.request.model.files);
  return isFixed ? [kind] : ["voxels", "smooth"];
}

function chooseKind(kind) {
  const { model } = opened.request;
  if (model) openModel(model, kind);
  else choose(opened.grid, kind);
}

// Has the worker show a grid, in the way that is wanted if that is possible.
function choose(number, wantedKind) {
  const { request, grids } = opened;
  const kind = kindsOf(grids[number]).includes(wantedKind) ? wantedKind : grids[number].kind;
  Object.assign(opened, { grid: number, kind });
  showChoices();
  say("Preparing the volume …");
  const subject = `${request.model?.name ?? request.number}, grid ${number}`;
  send("show", { number: request.number, grid: number, kind, subject, zIsUp: $("z-up").checked });
}

// Sets the controls to what is chosen.
function showChoices() {
  if (!opened) return;
  const { request, grids, grid, kind } = opened;
  $("model").querySelector(".own")?.remove();
  if (request.model) {
    $("model").value = request.model.name;
  } else {
    const option = new Option(request.title, "", true, true);
    option.className = "own";
    option.disabled = true;
    $("model").append(option);
  }
  $("grid-row").hidden = grids.length < 2;
  $("grid").replaceChildren(...grids.map(({ name }, i) => new Option(name || "(no name)", i, false, i === grid)));
  const kinds = kindsOf(grids[grid]);
  for (const input of document.querySelectorAll("[name=kind]")) {
    input.disabled = !kinds.includes(input.value);
    input.checked = input.value === kind;
  }
  $("data-label").textContent = DATA[kind];
  $("density-row").hidden = kind !== "fog";
  $("color-row").hidden = kind === "fog";
}

// What the worker reports

const bytesText = (bytes) => (bytes < 1e6 ? `${(bytes / 1e3).toFixed(0)} kB` : `${(bytes / 1e6).toFixed(1)} MB`);

const reports = {
  started({ adapter, isSoftware, hasTimestamps }) {
    $("adapter").textContent = adapter + (isSoftware ? " (software)" : "");
    $("frame-time").title = hasTimestamps ? "by the GPU’s clock" : "until the GPU has finished";
  },
  opened({ main, ...data }) {
    const wantedKind = data.request.kind ?? opened?.kind;
    opened = data;
    choose(main, wantedKind);
  },
  volume(data) {
    const isOther = data.subject !== volume?.subject || data.zIsUp !== volume.zIsUp;
    volume = data;
    if (isOther) orbit.frame(data.bounds.slice(0, 3), data.bounds.slice(3), data.kind === "fog" ? 0.14 : 0.3);
    say(opened.notes.length > 0 ? `Left out or changed: ${opened.notes.join("; ")}` : "");
    $("volume-bytes").textContent = bytesText(data.bytes);
    const own = performance.getEntriesByType("resource").map(({ name, encodedBodySize }) => [name, encodedBodySize]);
    const files = new Map([...own, ...data.loaded].filter(([name]) => !name.includes("/models/")));
    const [page] = performance.getEntriesByType("navigation");
    const code = [...files.values()].reduce((sum, bytes) => sum + bytes, page?.encodedBodySize ?? 0);
    $("loaded-bytes").textContent = `${bytesText(code)} page, ${bytesText(opened.bytes)} volume`;
    sendLook();
    sendCamera();
  },
  frame(data) {
    const { time, size, frame } = data;
    ({ isSettled } = data);
    const rate = (size[0] * size[1]) / time / 1e3;
    $("frame-time").textContent = `${time.toFixed(time < 10 ? 2 : 0)} ms`;
    $("ray-rate").textContent = `${rate.toFixed(rate < 10 ? 2 : 0)} million/s`;
    $("picture-size").textContent = `${size[0]} × ${size[1]}, ${frame + 1} ${frame > 0 ? "frames" : "frame"}`;
    frames = [...frames.slice(1 - MOST_FRAMES), { ...data, at: performance.now() }];
    if (!isSettled) return;
    waiting.splice(0).forEach(({ resolve }) => resolve());
  },
  pick({ voxel }) {
    const name = volume.kind === "voxels" ? "voxel " : "";
    $("pick").textContent = voxel ? `${name}${voxel.join(", ")}`.replaceAll("-", "−") : "–";
  },
  saved({ file, why }) {
    const { resolve, reject } = saving.shift();
    if (file) resolve(file);
    else reject(new Error(why));
  },
  failed,
  lost: ({ why }) => end("The picture has stopped", `The graphics device is gone: ${why}`),
};
worker.onmessage = ({ data }) => reports[data.type](data);
worker.onerror = (event) => {
  const message = event.message ?? "The page’s worker could not be started. A current browser may help.";
  failed({ message, isFatal: true });
};

// The picture as a PNG file.
function picture() {
  if (ended) return Promise.reject(ended);
  send("save");
  return new Promise((resolve, reject) => saving.push({ resolve, reject }));
}

async function download() {
  let file;
  try {
    file = await picture();
  } catch (error) {
    showMessage("The picture cannot be saved", error.message);
    return;
  }
  const link = document.createElement("a");
  link.href = URL.createObjectURL(file);
  link.download = "volume.png";
  link.click();
  URL.revokeObjectURL(link.href);
}

// Input

function listen() {
  $("save").addEventListener("click", download);
  new ResizeObserver(sendSize).observe(canvas);
  $("model").addEventListener("change", () => openModel(models[$("model").selectedIndex]));
  $("grid").addEventListener("change", () => choose(Number($("grid").value), opened.kind));
  $("kinds").addEventListener("change", ({ target }) => chooseKind(target.value));
  for (const id of ["azimuth", "elevation", "color", "density", "data"]) $(id).addEventListener("input", sendLook);
  $("z-up").addEventListener("change", () => send("up", { zIsUp: $("z-up").checked }));
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
  openModel(models.find(({ name }) => name === query.get("model")) ?? models[0], query.get("kind"));
}

// For scripts: see web/check.py.
globalThis.demo = {
  settled: async () => {
    if (ended) throw ended;
    if (!isSettled) await new Promise((resolve, reject) => waiting.push({ resolve, reject }));
  },
  frames: () => frames,
  picture: async () => {
    const bytes = new Uint8Array(await (await picture()).arrayBuffer());
    return btoa(Array.from(bytes, (byte) => String.fromCharCode(byte)).join(""));
  },
  state: () => ({ kind: volume.kind, camera: orbit.numbers(), extinction: look().extinction }),
};

start().catch((error) => failed({ message: error.message, isFatal: true }));
