// Traces a volume with WebGPU, in bands of rows, and shows the picture on a canvas.

// The bindings of `web/shaders/scene.wgsl` in group 2; groups 0 and 1 are empty, because they are Bevy's in the plugin.
const BINDINGS = ["read-only-storage", "read-only-storage", null, null, "uniform", "uniform", "storage", "storage"];
const TILE = 8;
const LOOK_BYTES = 48;
const SHOWN_BYTES = 32;
const VIEW_BYTES = 304;
// The milliseconds that a dispatch should take at most: systems reset a GPU that hangs for seconds.
const BAND_TIME = 120;
// Rows of tiles in the first band of a volume, whose cost is unknown, and how much larger the next one may be: its rows
// may cost more.
const FIRST_BAND = 4;
const BAND_GROWTH = 4;
// Bytes of a ray's light, in each of two buffers.
const RAY_BYTES = 16;
const EXPOSURE = 1.0;

async function text(url) {
  const response = await fetch(url);
  if (!response.ok) throw new Error(`${url}: ${response.status} ${response.statusText}`);
  return response.text();
}

async function openAdapter() {
  if (!isSecureContext) throw new Error("Browsers offer WebGPU only to pages that are served over HTTPS.");
  if (!navigator.gpu) {
    throw new Error("This browser has no WebGPU. Chrome and Edge 113, Safari 26 and Firefox 141 have it.");
  }
  const adapter = await navigator.gpu.requestAdapter({ powerPreference: "high-performance" });
  if (!adapter) {
    throw new Error("WebGPU finds no graphics adapter here. Updating the browser or the graphics driver may help.");
  }
  return adapter;
}

export class Renderer {
  // Calls `lost` with a reason if the device goes away, and `failed` with the first error of the GPU: others follow
  // from it.
  static async create(canvas, { lost, failed }) {
    const adapter = await openAdapter();
    const requiredFeatures = ["timestamp-query"].filter((name) => adapter.features.has(name));
    const device = await adapter.requestDevice({ requiredFeatures });
    const renderer = new Renderer(canvas, device, adapter.info ?? {});
    device.lost.then(({ reason, message }) => {
      if (reason !== "destroyed") lost(message || "the driver gave no reason.");
    });
    const described = ({ error }) => `The GPU reports an error: ${error.message || error.constructor.name}`;
    device.addEventListener("uncapturederror", (event) => console.error(described(event)));
    device.addEventListener("uncapturederror", (event) => failed(new Error(described(event))), { once: true });
    await renderer.#presentIn(renderer.#format);
    return renderer;
  }

  #device;
  #canvas;
  #context;
  #format;
  #pipelines = new Map();
  #layouts;
  #shownLayout;
  // By the format that they draw in.
  #presents = new Map();
  #presentModule;
  #buffers = {};
  #volumeBuffers = [];
  #pipeline = null;
  #group = null;
  #presented = null;
  #timer = null;
  // Milliseconds per ray, of the frame before and of its slowest band; 0 while unknown.
  #cost = 0;
  #slowest = 0;

  constructor(canvas, device, info) {
    this.#device = device;
    this.#canvas = canvas;
    this.#context = canvas.getContext("webgpu");
    this.#format = navigator.gpu.getPreferredCanvasFormat();
    this.#context.configure({ device, format: this.#format, alphaMode: "opaque" });
    const { vendor, architecture, device: model, description } = info;
    this.adapter = [...new Set([vendor, architecture, model, description])].filter((part) => part).join(", ");
    this.isSoftware = Boolean(info.isFallbackAdapter) || /swiftshader|llvmpipe|warp/i.test(this.adapter);
    this.largestVolume = Math.min(device.limits.maxStorageBufferBindingSize, device.limits.maxBufferSize);
    this.mostRays = Math.floor(this.largestVolume / RAY_BYTES);
    const entries = BINDINGS.flatMap((type, binding) =>
      type ? [{ binding, visibility: GPUShaderStage.COMPUTE, buffer: { type } }] : [],
    );
    const empty = device.createBindGroupLayout({ entries: [] });
    this.#layouts = [empty, empty, device.createBindGroupLayout({ entries })];
    const shown = ["uniform", "read-only-storage", "read-only-storage"];
    this.#shownLayout = device.createBindGroupLayout({
      entries: shown.map((type, binding) => ({ binding, visibility: GPUShaderStage.FRAGMENT, buffer: { type } })),
    });
    this.#buffers.view = this.#buffer(VIEW_BYTES, GPUBufferUsage.UNIFORM);
    this.#buffers.look = this.#buffer(LOOK_BYTES, GPUBufferUsage.UNIFORM);
    this.#buffers.shown = this.#buffer(SHOWN_BYTES, GPUBufferUsage.UNIFORM);
    if (device.features.has("timestamp-query")) this.#timer = new Timer(device);
  }

  get hasTimestamps() {
    return this.#timer !== null;
  }

  // Milliseconds that a frame of a number of rays takes, as far as known.
  estimate(rays) {
    const cost = this.#cost || this.#slowest;
    return cost > 0 ? cost * rays : null;
  }

  #buffer(size, usage) {
    return this.#device.createBuffer({ size, usage: usage | GPUBufferUsage.COPY_DST });
  }

  async #module(name) {
    const module = this.#device.createShaderModule({ code: await text(`shaders/${name}.wgsl`), label: name });
    const { messages } = await module.getCompilationInfo();
    const error = messages.find(({ type }) => type === "error");
    if (error) throw new Error(`the shader ${name} is not compiled: ${error.message}`);
    return module;
  }

  // The pipeline that shows what has been traced, in a format.
  async #presentIn(format) {
    if (!this.#presents.has(format)) {
      this.#presentModule ??= await this.#module("present");
      const module = this.#presentModule;
      const pipeline = await this.#device.createRenderPipelineAsync({
        layout: this.#device.createPipelineLayout({ bindGroupLayouts: [this.#shownLayout] }),
        vertex: { module, entryPoint: "corners" },
        fragment: { module, entryPoint: "present", targets: [{ format }] },
      });
      this.#presents.set(format, pipeline);
    }
    return this.#presents.get(format);
  }

  // The pipeline for a kind of volumes.
  async compile(kind, isWide) {
    const name = `${kind}${isWide ? "-wide" : ""}`;
    if (!this.#pipelines.has(name)) {
      const layout = this.#device.createPipelineLayout({ bindGroupLayouts: this.#layouts });
      const module = await this.#module(name);
      const compute = { module, entryPoint: "trace" };
      this.#pipelines.set(name, await this.#device.createComputePipelineAsync({ layout, compute }));
    }
    return this.#pipelines.get(name);
  }

  // Uploads a volume: its header, and its words as a view of memory, which are copied.
  show(pipeline, header, words) {
    this.#pipeline = pipeline;
    [this.#cost, this.#slowest] = [0, 0];
    this.#volumeBuffers.forEach((buffer) => buffer.destroy());
    const contents = [header, words];
    this.#volumeBuffers = contents.map(({ byteLength }) =>
      this.#buffer(Math.max(byteLength, 16), GPUBufferUsage.STORAGE),
    );
    contents.forEach((data, i) => this.#device.queue.writeBuffer(this.#volumeBuffers[i], 0, data));
    this.#group = null;
  }

  resize(width, height) {
    this.#canvas.width = width;
    this.#canvas.height = height;
  }

  // Room for the rays of a frame.
  #reserve(rays) {
    const bytes = RAY_BYTES * rays;
    if ((this.#buffers.first?.size ?? 0) >= bytes) return;
    for (const name of ["first", "sum"]) {
      this.#buffers[name]?.destroy();
      this.#buffers[name] = this.#buffer(bytes, GPUBufferUsage.STORAGE);
    }
    this.#group = null;
  }

  #bind() {
    if (this.#group) return;
    const { view, look, first, sum, shown } = this.#buffers;
    const [header, words] = this.#volumeBuffers;
    const entry = (binding, buffer) => ({ binding, resource: { buffer } });
    const own = [header, words, null, null, view, look, first, sum];
    const groups = [[], [], own.flatMap((buffer, i) => (buffer ? [entry(i, buffer)] : []))];
    this.#group = groups.map((entries, i) => this.#device.createBindGroup({ layout: this.#layouts[i], entries }));
    this.#presented = this.#device.createBindGroup({
      layout: this.#shownLayout,
      entries: [shown, first, sum].map((buffer, i) => entry(i, buffer)),
    });
  }

  #writeLook(look, frame, [width, height], firstRow) {
    const data = new DataView(new ArrayBuffer(LOOK_BYTES));
    look.toSun.forEach((x, i) => data.setFloat32(4 * i, x, true));
    data.setFloat32(12, look.extinction, true);
    look.color.forEach((x, i) => data.setFloat32(16 + 4 * i, x, true));
    [frame, width, height, firstRow, look.showsData ? 1 : 0].forEach((x, i) => data.setUint32(28 + 4 * i, x, true));
    this.#device.queue.writeBuffer(this.#buffers.look, 0, data);
  }

  // Traces a frame of a size in rays. Returns its milliseconds, or null if `isStale` has said that nobody wants it
  // any more.
  async trace(view, look, frame, size, isStale) {
    const [width, height] = size;
    this.#reserve(width * height);
    this.#bind();
    this.#device.queue.writeBuffer(this.#buffers.view, 0, view);
    const [columns, rows] = size.map((rays) => Math.ceil(rays / TILE));
    const rowRays = width * TILE;
    let [time, slowest, most] = [0, 0, this.#slowest > 0 ? rows : FIRST_BAND];
    for (let first = 0; first < rows; most *= BAND_GROWTH) {
      const fitting = Math.floor(BAND_TIME / (this.#slowest * rowRays));
      const wanted = Math.max(Math.min(fitting, most), 1);
      const band = Math.min(wanted, rows - first);
      this.#writeLook(look, frame, size, first);
      const own = await this.#dispatch(columns, band);
      // If the end of the picture cuts a band short, most of its time may be overhead.
      if (band === wanted || own > BAND_TIME) slowest = Math.max(slowest, own / (band * rowRays));
      this.#slowest = Math.max(this.#slowest, slowest);
      time += own;
      first += band;
      if (first < rows && isStale()) return null;
    }
    this.#slowest = slowest || this.#slowest;
    this.#cost = time / (width * height);
    return time;
  }

  async #dispatch(columns, rows) {
    const encoder = this.#device.createCommandEncoder();
    const pass = encoder.beginComputePass(this.#timer ? { timestampWrites: this.#timer.writes } : {});
    pass.setPipeline(this.#pipeline);
    this.#group.forEach((group, i) => pass.setBindGroup(i, group));
    pass.dispatchWorkgroups(columns, rows);
    pass.end();
    this.#timer?.resolve(encoder);
    const start = performance.now();
    this.#device.queue.submit([encoder.finish()]);
    if (this.#timer) return this.#timer.read();
    await this.#device.queue.onSubmittedWorkDone();
    return performance.now() - start;
  }

  // Shows what has been traced on the canvas, at a size in rays and with a number of frames in the sum.
  async present([width, height], frames, showsData) {
    const data = new DataView(new ArrayBuffer(SHOWN_BYTES));
    const { width: canvasWidth, height: canvasHeight } = this.#canvas;
    const numbers = [width, height, canvasWidth, canvasHeight, frames, showsData ? 1 : 0];
    numbers.forEach((x, i) => data.setUint32(4 * i, x, true));
    data.setFloat32(24, EXPOSURE, true);
    this.#device.queue.writeBuffer(this.#buffers.shown, 0, data);
    const pipeline = await this.#presentIn(this.#format);
    const encoder = this.#device.createCommandEncoder();
    this.#draw(encoder, pipeline, this.#context.getCurrentTexture());
    this.#device.queue.submit([encoder.finish()]);
    await this.#device.queue.onSubmittedWorkDone();
  }

  #draw(encoder, pipeline, texture) {
    const view = texture.createView();
    const pass = encoder.beginRenderPass({ colorAttachments: [{ view, loadOp: "clear", storeOp: "store" }] });
    pass.setPipeline(pipeline);
    pass.setBindGroup(0, this.#presented);
    pass.draw(3);
    pass.end();
  }

  // What is on the canvas, drawn once more: a canvas may not be read after it has been shown.
  async picture() {
    const { width, height } = this.#canvas;
    const format = "rgba8unorm";
    const pipeline = await this.#presentIn(format);
    const texture = this.#device.createTexture({
      size: [width, height],
      format,
      usage: GPUTextureUsage.RENDER_ATTACHMENT | GPUTextureUsage.COPY_SRC,
    });
    // As copies require.
    const bytesPerRow = Math.ceil((4 * width) / 256) * 256;
    const buffer = this.#device.createBuffer({
      size: bytesPerRow * height,
      usage: GPUBufferUsage.COPY_DST | GPUBufferUsage.MAP_READ,
    });
    const encoder = this.#device.createCommandEncoder();
    this.#draw(encoder, pipeline, texture);
    encoder.copyTextureToBuffer({ texture }, { buffer, bytesPerRow }, [width, height]);
    this.#device.queue.submit([encoder.finish()]);
    await buffer.mapAsync(GPUMapMode.READ);
    const rows = new Uint8Array(buffer.getMappedRange());
    const image = new ImageData(width, height);
    for (let y = 0; y < height; y++) {
      image.data.set(rows.subarray(y * bytesPerRow, y * bytesPerRow + 4 * width), 4 * width * y);
    }
    buffer.destroy();
    texture.destroy();
    return image;
  }
}

// The time of a pass by the GPU's own clock.
class Timer {
  #set;
  #resolved;
  #read;

  constructor(device) {
    this.#set = device.createQuerySet({ type: "timestamp", count: 2 });
    const { QUERY_RESOLVE, COPY_SRC, COPY_DST, MAP_READ } = GPUBufferUsage;
    this.#resolved = device.createBuffer({ size: 16, usage: QUERY_RESOLVE | COPY_SRC });
    this.#read = device.createBuffer({ size: 16, usage: COPY_DST | MAP_READ });
    this.writes = { querySet: this.#set, beginningOfPassWriteIndex: 0, endOfPassWriteIndex: 1 };
  }

  resolve(encoder) {
    encoder.resolveQuerySet(this.#set, 0, 2, this.#resolved, 0);
    encoder.copyBufferToBuffer(this.#resolved, 0, this.#read, 0, 16);
  }

  // Milliseconds of the pass submitted last.
  async read() {
    await this.#read.mapAsync(GPUMapMode.READ);
    const [begin, end] = new BigUint64Array(this.#read.getMappedRange());
    this.#read.unmap();
    // Clocks may be coarse, or be reset.
    return Math.max(Number(end - begin) / 1e6, 0.001);
  }
}
