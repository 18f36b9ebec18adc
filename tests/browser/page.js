// Traces the rays that `crates/vdb_probe/tests/accuracy/browser.rs` has written with this browser's WebGPU, and
// compares each answer with the right one. Then has the browser check every shader variant. Everything is sent to
// `serve.py`, which prints it.

// Bytes of a ray, of what the kernel writes for one, and of the right answer to one.
const RAY = 48;
const HIT = 48;
const ANSWER = 24;
// The group and the bindings of `probe.wgsl`, and its workgroup size.
const GROUP = 2;
const BINDINGS = { grid: 0, words: 1, rays: 4, hits: 5, setup: 6 };
const WORKGROUP = 64;
// The face of a right answer that is a miss.
const MISS = 4;
// Rays whose data are shown if their answers are wrong, of each grid.
const EXAMPLES = 3;
// How many variants are compiled before their result is reported.
const REPORTED = 50;

async function report(kind, data) {
  const text = JSON.stringify({ kind, ...data });
  document.getElementById("log").textContent += text + "\n";
  await fetch("/report", { method: "POST", body: text });
}

async function bytes(path, from, length) {
  const headers = length === undefined ? {} : { Range: `bytes=${from}-${from + length - 1}` };
  const response = await fetch(path, { headers });
  if (!response.ok) throw new Error(`${path}: ${response.status}`);
  return response.arrayBuffer();
}

async function openDevice() {
  if (!navigator.gpu) throw new Error("this browser has no WebGPU");
  const adapter = await navigator.gpu.requestAdapter();
  if (!adapter) throw new Error("this browser has no WebGPU adapter");
  const { maxStorageBufferBindingSize, maxBufferSize } = adapter.limits;
  const device = await adapter.requestDevice({
    requiredFeatures: [...adapter.features].filter((name) => FEATURES.includes(name)),
    requiredLimits: { maxStorageBufferBindingSize, maxBufferSize },
  });
  device.lost.then((why) => report("error", { message: `the device is lost: ${why.message}` }));
  const { vendor, architecture, description } = adapter.info;
  await report("adapter", {
    adapter: [vendor, architecture, description].filter((part) => part).join(", "),
    browser: navigator.userAgent,
  });
  return device;
}

// Features of WebGPU that the plugin uses where an adapter has them.
const FEATURES = ["float32-filterable", "float32-blendable", "texture-formats-tier1"];

function buffer(device, contents, usage) {
  const made = device.createBuffer({ size: Math.max(contents.byteLength, 16), usage: usage | GPUBufferUsage.COPY_DST });
  device.queue.writeBuffer(made, 0, contents);
  return made;
}

async function kernel(device, code, entryPoint) {
  const module = device.createShaderModule({ code });
  const messages = (await module.getCompilationInfo()).messages.filter(({ type }) => type === "error");
  if (messages.length > 0) throw new Error(`the kernel is not compiled: ${messages[0].message}`);
  return device.createComputePipelineAsync({ layout: "auto", compute: { module, entryPoint } });
}

// Sends rays through a grid, and reads what they meet.
async function trace(device, pipeline, grid, words, rays) {
  const count = rays.byteLength / RAY;
  const size = count * HIT;
  const hits = device.createBuffer({ size, usage: GPUBufferUsage.STORAGE | GPUBufferUsage.COPY_SRC });
  const read = device.createBuffer({ size, usage: GPUBufferUsage.MAP_READ | GPUBufferUsage.COPY_DST });
  const given = buffer(device, rays, GPUBufferUsage.STORAGE);
  const setup = buffer(device, new Uint32Array([0, 0, count, 0]), GPUBufferUsage.UNIFORM);
  const buffers = { grid, words, rays: given, hits, setup };
  const entries = Object.entries(BINDINGS).map(([name, binding]) => ({ binding, resource: { buffer: buffers[name] } }));
  const encoder = device.createCommandEncoder();
  const pass = encoder.beginComputePass();
  pass.setPipeline(pipeline);
  pass.setBindGroup(GROUP, device.createBindGroup({ layout: pipeline.getBindGroupLayout(GROUP), entries }));
  pass.dispatchWorkgroups(Math.ceil(count / WORKGROUP));
  pass.end();
  encoder.copyBufferToBuffer(hits, 0, read, 0, size);
  device.queue.submit([encoder.finish()]);
  await read.mapAsync(GPUMapMode.READ);
  const found = read.getMappedRange().slice(0);
  [hits, read, given, setup].forEach((own) => own.destroy());
  return found;
}

// Compares answers with the right ones, exactly as `voxels::judge` does.
function judge(tally, { tError, mostSteps }, rays, found, answers) {
  const ints = new Int32Array(found);
  const floats = new Float32Array(found);
  const truth = new Int32Array(answers);
  const times = new Float64Array(answers);
  for (let i = 0; i < found.byteLength / HIT; i++) {
    const hit = i * 12;
    const right = i * 6;
    const misses = truth[right + 5] === MISS;
    const t = floats[hit + 8];
    let isWrong = (ints[hit + 7] === 0) !== misses;
    if (!isWrong && !misses) {
      isWrong = [0, 1, 2, 3].some((part) => ints[hit + part] !== truth[right + 2 + part]);
      const exact = times[i * 3];
      const error = t === exact ? 0 : Math.abs(t - exact) / Math.abs(exact);
      if (!isWrong) tally.largest = Math.max(tally.largest, error);
      isWrong ||= !(error <= tError);
    }
    const steps = ints[hit + 10] >>> 0;
    isWrong ||= !Number.isFinite(t) || steps > mostSteps;
    tally.rays += 1;
    tally.hits += misses ? 0 : 1;
    if (!isWrong) continue;
    tally.wrong += 1;
    if (tally.examples.length < EXAMPLES) {
      const words = [...new Uint32Array(rays, i * RAY, 12)].map((word) => word.toString(16)).join(" ");
      const met = ints[hit + 7] ? `cell ${ints.slice(hit, hit + 3)}, face ${ints[hit + 3]}` : "nothing";
      const should = misses ? "nothing" : `cell ${truth.slice(right + 2, right + 5)}, face ${truth[right + 5]}`;
      tally.examples.push(`ray ${words}: ${met} at ${t} after ${steps} steps, not ${should} at ${times[i * 3]}`);
    }
  }
}

async function runCase(device, list, pipeline, number) {
  const own = list.cases[number];
  const path = (what) => `/data/${number}.${what}`;
  const grid = buffer(device, await bytes(path("grid")), GPUBufferUsage.STORAGE);
  const words = buffer(device, await bytes(path("words")), GPUBufferUsage.STORAGE);
  const tally = { rays: 0, hits: 0, wrong: 0, largest: 0, examples: [] };
  let seconds = 0;
  for (let first = 0; first < own.rays; first += list.batch) {
    const count = Math.min(list.batch, own.rays - first);
    const rays = await bytes(path("rays"), first * RAY, count * RAY);
    const answers = await bytes(path("answers"), first * ANSWER, count * ANSWER);
    const start = performance.now();
    const found = await trace(device, pipeline, grid, words, rays);
    seconds += (performance.now() - start) / 1000;
    judge(tally, { tError: list.tError, mostSteps: own.mostSteps }, rays, found, answers);
  }
  grid.destroy();
  words.destroy();
  await report("case", { name: own.name, seconds, secondsHere: own.secondsHere, ...tally });
}

async function runCases(device) {
  const list = JSON.parse(new TextDecoder().decode(await bytes("/data/cases.json")));
  await report("list", { cases: list.cases.length, adapter: list.adapter });
  const pipelines = [];
  for (const code of list.kernels) pipelines.push(await kernel(device, code, list.entry));
  for (let number = 0; number < list.cases.length; number++) {
    await runCase(device, list, pipelines[list.cases[number].kernel], number);
  }
}

async function checkVariants(device) {
  const names = JSON.parse(new TextDecoder().decode(await bytes("/variants")));
  let failures = [];
  for (let i = 0; i < names.length; i++) {
    const code = new TextDecoder().decode(await bytes(`/variants/${names[i]}`));
    device.pushErrorScope("validation");
    const info = await device.createShaderModule({ code }).getCompilationInfo();
    const invalid = await device.popErrorScope();
    const errors = info.messages.filter(({ type }) => type === "error");
    const message = errors.length > 0 ? errors[0].message : invalid?.message;
    if (message) failures.push({ name: names[i], defs: code.slice(0, code.indexOf("\n")), message });
    if ((i + 1) % REPORTED === 0 || i + 1 === names.length) {
      await report("variants_of", { done: i + 1, all: names.length, failures });
      failures = [];
    }
  }
}

try {
  const device = await openDevice();
  device.addEventListener("uncapturederror", ({ error }) => report("error", { message: error.message }));
  await runCases(device);
  await checkVariants(device);
  await report("end", {});
} catch (error) {
  await report("error", { message: String(error) });
}
