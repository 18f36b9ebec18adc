//! Sequences at the rate of the screen: late frames, frame times, memory, and seeks.

use std::path::Path;
use std::time::{Duration, Instant};

use bevy::asset::UnapprovedPathMode;
use bevy::camera::Hdr;
use bevy::prelude::*;
use bevy_vdb::prelude::*;
use bevy_vdb::vdb_core::synth::Random;
use bevy_vdb::{VdbGpuMemory, VdbGpuUsage};

use crate::studio::Studio;
use crate::{Args, print_heading};

/// What decoded frames may take, in bytes.
const CACHE: u64 = 192 << 20;
/// What the pool may keep beside the frame that is shown, in bytes.
const IDLE: u64 = 24 << 20;
/// Updates at the beginning of each row that are not measured: two seconds at 60 per second, and more while
/// pipelines are compiled.
const WARM_UP: usize = 120;
/// Seeks to frames at random.
const SEEKS: usize = 60;
/// World units across the longest edge of the first frame: more than the camera's orbit.
const EDGE: f32 = 4.0;

/// An app that plays a sequence.
trait Stage {
    fn app(&mut self) -> &mut App;

    /// An update; the milliseconds that it took.
    fn update(&mut self) -> f64;
}

impl Stage for Studio {
    fn app(&mut self) -> &mut App {
        &mut self.app
    }

    fn update(&mut self) -> f64 {
        self.frames(1).into_iter().sum()
    }
}

/// An app that draws nothing: all it does is to read and decode.
struct Unseen(App);

impl Unseen {
    fn new() -> Self {
        let mut app = App::new();
        let any = UnapprovedPathMode::Allow;
        app.add_plugins((
            MinimalPlugins,
            AssetPlugin { unapproved_path_mode: any, ..default() },
            VdbRenderPlugin,
        ));
        Self(app)
    }
}

impl Stage for Unseen {
    fn app(&mut self) -> &mut App {
        &mut self.0
    }

    fn update(&mut self) -> f64 {
        let start = Instant::now();
        self.0.update();
        start.elapsed().as_secs_f64() * 1e3
    }
}

/// Waits for the next frame of a screen.
struct Screen {
    next: Instant,
    interval: Duration,
}

impl Screen {
    fn new(rate: u32) -> Self {
        Self { next: Instant::now(), interval: Duration::from_secs_f64(1.0 / f64::from(rate)) }
    }

    fn wait(&mut self) {
        std::thread::sleep(self.next.saturating_duration_since(Instant::now()));
        // A frame that takes longer is shown by the next one of the screen.
        while self.next <= Instant::now() {
            self.next += self.interval;
        }
    }
}

pub fn run(args: &Args) -> Result<(), String> {
    let Some(folder) = &args.model else {
        return Err("sequence: name the folder of the frames by --model".into());
    };
    let folder = std::fs::canonicalize(folder).map_err(|error| error.to_string())?;
    let mut studio = Studio::new(args.size)?;
    print_heading(&studio, "Sequence", args.size);
    println!("{}: {} rounds of the loop each way\n", folder.display(), args.rounds);
    println!(
        "| at {} per second | shown | late | update, ms, median | 99 % | 99.9 % | longest | CPU cores \
         | frames in memory, MB | of the process, MB | GPU, MB |",
        args.rate
    );
    println!("|---|---|---|---|---|---|---|---|---|---|---|");
    let mut unseen = Unseen::new();
    let player = spawn(&mut unseen, &folder, args);
    play(&mut unseen, player, "only decoded", 1.0, args)?;
    let only_decoded = seeks(&mut unseen, player, args.rate)?;
    let dragged = drag(&mut unseen, player, args.rate)?;
    drop(unseen);
    studio.camera_mut().insert((Hdr, Msaa::Off, VdbQuality::BALANCED));
    let player = spawn(&mut studio, &folder, args);
    play(&mut studio, player, "forwards", 1.0, args)?;
    play(&mut studio, player, "backwards", -1.0, args)?;
    let drawn = seeks(&mut studio, player, args.rate)?;
    println!(
        "\n{SEEKS} seeks at random, each as soon as the one before is shown, at {} updates per second\n",
        args.rate
    );
    println!("| | updates until it is shown, median | 90 % | most | ms, median | 90 % | most |");
    println!("|---|---|---|---|---|---|---|");
    println!("| only decoded | {only_decoded} |");
    println!("| drawn | {drawn} |");
    println!(
        "\nonly decoded, dragged through all frames and back with a seek in each update: {dragged}"
    );
    Ok(())
}

fn spawn(stage: &mut impl Stage, folder: &Path, args: &Args) -> Entity {
    let world = stage.app().world_mut();
    world.insert_resource(VdbFrameCache { bytes: CACHE, ..default() });
    world.insert_resource(VdbGpuMemory { idle_bytes: IDLE, ..default() });
    let sequence = world.resource::<AssetServer>().load_vdb_sequence(folder.to_string_lossy());
    let player = VdbPlayer::new(sequence).with_frame_rate(args.rate as f32);
    let material = VdbMaterial { density_scale: args.density, anisotropy: 0.6, ..default() };
    world.spawn((player, material)).id()
}

fn player(stage: &mut impl Stage, player: Entity) -> Result<Mut<'_, VdbPlayer>, String> {
    stage.app().world_mut().get_mut(player).ok_or_else(|| "no player".to_owned())
}

fn status(stage: &mut impl Stage, player: Entity) -> Result<VdbPlayerStatus, String> {
    stage.app().world().get(player).cloned().ok_or_else(|| "no player".to_owned())
}

/// Waits for the first frame and scales it; returns the numbers of the first frame and of all.
fn place(stage: &mut impl Stage, player: Entity) -> Result<(u64, u64), String> {
    let start = Instant::now();
    while status(stage, player)?.frame().is_none() {
        stage.update();
        if start.elapsed() > Duration::from_secs(60) {
            return Err("no frame of the sequence can be loaded".into());
        }
    }
    let world = stage.app().world_mut();
    let grid = world.get::<VdbVolume>(player).ok_or("no volume")?.0.clone();
    let grids = world.resource::<Assets<VdbGrid>>();
    let bounds = grids.get(&grid).and_then(VdbGrid::world_bounds);
    let (low, high) = bounds.ok_or("the first frame is empty")?;
    let scale = EDGE / (high - low).max_element() as f32;
    let middle = ((low + high) * 0.5).as_vec3();
    let place = Transform::from_scale(Vec3::splat(scale)).with_translation(-scale * middle);
    world.entity_mut(player).insert(place);
    let (first, last) = status(stage, player)?.range().ok_or("no range")?;
    Ok((first, last - first + 1))
}

/// Plays all rounds, and prints a row.
fn play(
    stage: &mut impl Stage,
    entity: Entity,
    name: &str,
    speed: f32,
    args: &Args,
) -> Result<(), String> {
    let (_, frames) = place(stage, entity)?;
    player(stage, entity)?.speed = speed;
    // Until memory has been taken, and what was loaded ahead in the other direction is of no more use.
    let mut screen = Screen::new(args.rate);
    for _ in 0..WARM_UP {
        screen.wait();
        stage.update();
    }
    let seconds = frames as f64 * args.rounds as f64 / f64::from(args.rate);
    let late = status(stage, entity)?.late();
    let (start, cpu) = (Instant::now(), cpu_seconds());
    let (mut times, mut shown, mut before, mut most) = (Vec::new(), 0_u64, None, [0; 3]);
    while start.elapsed().as_secs_f64() < seconds {
        screen.wait();
        times.push(stage.update());
        let frame = status(stage, entity)?.frame();
        shown += u64::from(frame != before);
        before = frame;
        // Counting the nodes of trees takes time.
        if times.len() % 30 == 1 {
            for (most, now) in most.iter_mut().zip(memory(stage.app().world())) {
                *most = now.max(*most);
            }
        }
    }
    let wall = start.elapsed().as_secs_f64();
    let cores = cpu_seconds().zip(cpu).map(|(now, before)| (now - before) / wall);
    let late = status(stage, entity)?.late() - late;
    times.sort_by(f64::total_cmp);
    let at = |part: f64| times[((times.len() as f64 * part) as usize).min(times.len() - 1)];
    let [held, process, gpu] = most.map(|bytes| bytes as f64 / 1e6);
    println!(
        "| {name} | {shown} | {late} | {:.2} | {:.2} | {:.2} | {:.2} | {} | {held:.0} | {process:.0} | {gpu:.0} |",
        at(0.5),
        at(0.99),
        at(0.999),
        at(1.0),
        cores.map_or("–".into(), |cores| format!("{cores:.2}")),
    );
    Ok(())
}

/// Bytes of all grids, of the process, and of the pool.
fn memory(world: &World) -> [u64; 3] {
    let grids = world.resource::<Assets<VdbGrid>>();
    let held = grids.iter().map(|(_, grid)| bytes(grid)).sum();
    [held, resident_bytes(), world.get_resource().map_or(0, VdbGpuUsage::bytes)]
}

/// The bytes of a grid in memory.
fn bytes(grid: &VdbGrid) -> u64 {
    grid.packed().bytes() + grid.tree().map_or(0, |tree| tree.stats().bytes)
}

/// Seeks while paused. Returns the columns of a table: the number of updates up to and including the
/// one that shows the frame, and the time from the seek, just before the first of them, to the end of
/// the last.
fn seeks(stage: &mut impl Stage, entity: Entity, rate: u32) -> Result<String, String> {
    let (first, frames) = place(stage, entity)?;
    let mut random = Random::new(5);
    let (mut updates, mut times) = (Vec::new(), Vec::new());
    let mut screen = Screen::new(rate);
    for _ in 0..SEEKS {
        screen.wait();
        let frame = first + random.below(frames);
        let mut own = player(stage, entity)?;
        own.pause();
        own.seek(frame);
        let (start, mut count) = (Instant::now(), 0_u32);
        loop {
            stage.update();
            count += 1;
            if status(stage, entity)?.frame() == Some(frame) {
                break;
            }
            if start.elapsed() > Duration::from_secs(30) {
                return Err(format!("frame {frame} does not come"));
            }
            screen.wait();
        }
        updates.push(count);
        times.push(start.elapsed().as_secs_f64() * 1e3);
    }
    updates.sort_unstable();
    times.sort_by(f64::total_cmp);
    let places = [SEEKS / 2, SEEKS * 9 / 10, SEEKS - 1];
    let cells = places.map(|i| updates[i].to_string()).into_iter();
    let cells = cells.chain(places.map(|i| format!("{:.0}", times[i])));
    Ok(cells.collect::<Vec<_>>().join(" | "))
}

/// Drags the timeline while paused: from the first frame to the last and back, with a seek in each
/// update. Returns how often another frame is shown, the longest time without another one, and how far
/// the shown frame is from the wanted one.
fn drag(stage: &mut impl Stage, entity: Entity, rate: u32) -> Result<String, String> {
    let (first, frames) = place(stage, entity)?;
    player(stage, entity)?.pause();
    let mut screen = Screen::new(rate);
    let (mut shown, mut before, mut longest) = (0, status(stage, entity)?.frame(), 0.0_f64);
    let (mut since, mut distance) = (Instant::now(), 0);
    for slot in (0..frames).chain((0..frames).rev()) {
        screen.wait();
        player(stage, entity)?.seek(first + slot);
        stage.update();
        let frame = status(stage, entity)?.frame();
        distance += frame.map_or(frames, |frame| frame.abs_diff(first + slot));
        longest = longest.max(since.elapsed().as_secs_f64() * 1e3);
        if frame != before {
            (shown, before, since) = (shown + 1, frame, Instant::now());
        }
    }
    let distance = distance as f64 / (2 * frames) as f64;
    Ok(format!(
        "{shown} frames shown in {} updates, at most {longest:.0} ms apart, in the mean {distance:.1} \
         frames from the wanted one",
        2 * frames
    ))
}

/// The CPU time of this process, where the system tells it.
fn cpu_seconds() -> Option<f64> {
    // The fields after the name, which ends with the last parenthesis, in ticks of 10 ms.
    let stat = std::fs::read_to_string("/proc/self/stat").ok()?;
    let fields: Vec<&str> = stat.rsplit_once(')')?.1.split_whitespace().collect();
    let ticks = |i: usize| fields.get(i)?.parse::<f64>().ok();
    Some((ticks(11)? + ticks(12)?) / 100.0)
}

/// The memory of this process, where the system tells it.
fn resident_bytes() -> u64 {
    let pages = std::fs::read_to_string("/proc/self/statm").ok();
    let pages = pages.and_then(|text| text.split_whitespace().nth(1)?.parse::<u64>().ok());
    4096 * pages.unwrap_or(0)
}
