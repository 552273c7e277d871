//! The experiments of Wang et al. (2013) and our own, one module each, and what they share: a
//! laboratory that bakes scenes, draws them and ray-traces truth.

mod adaptive;
mod bounce;
mod boundary;
mod brdf;
mod compression;
mod contours;
mod defaults;
mod edits;
mod end_to_end;
mod environments;
mod interpolation;
mod list;
mod meshes;
mod occluders;
mod penumbra;
pub mod report;
mod results;
mod scale;
mod scenes;
mod speed;

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::rc::Rc;
use std::time::Instant;

use anyhow::Context as _;
use relight_bake::environment::hdr::{self, LatLong};
use relight_bake::environment::{self, FitOptions};
use relight_bake::error::Error;
use relight_bake::files::{Access, Files};
use relight_bake::monitor::Monitor;
use relight_bake::scene::load::SceneInput;
use relight_bake::scene::{self, load};
use relight_format::{self as format, Camera, Environment, Limits, Scene};
use relight_runtime::{CellsOptions, Frame, Method, PolarOptions, Prefiltered, Sources};
use relight_shading::spherical_gaussian::SphericalGaussian;

pub use self::list::{ALL, Experiment};
pub use self::report::Section;
use self::report::{Cell, Figure};
pub use self::results::{around_results, write_results};
use crate::bench::{self, Timed};
use crate::compare::{Comparison, compare};
use crate::image_file::{self, Image};
use crate::render::Renderer;
use crate::truth::lobes::{self, Visibility};
use crate::{display, truth};

/// What to draw, where and how well.
#[derive(Clone, Debug)]
pub struct Settings {
    /// Folder for everything that is written.
    pub folder: PathBuf,
    /// Folder of meshes, environments and measured BRDFs.
    pub data: PathBuf,
    /// Picture size, pixels.
    pub size: [u32; 2],
    /// Truth samples per pixel.
    pub samples: u32,
    /// Start of every bake.
    pub bake: scene::Options,
    /// Of `compression`: scene files with a camera, in place of its own.
    pub scenes: Vec<PathBuf>,
    /// Of `compression`: distant light, in place of its own.
    pub lights: Option<Vec<SphericalGaussian>>,
    /// The command that runs the experiment, for the report.
    pub command: String,
}

/// All sections in a folder, of whatever runs, in the order of the report.
pub fn sections(folder: &Path) -> anyhow::Result<Vec<Section>> {
    let mut sections = Vec::new();
    for experiment in &ALL {
        let path = folder.join(experiment.name).join("section.json");
        if path.exists() {
            let text = std::fs::read(&path).with_context(|| path.display().to_string())?;
            let section = serde_json::from_slice(&text);
            sections.push(section.with_context(|| path.display().to_string())?);
        }
    }
    Ok(sections)
}

/// Writes `report.html` from all sections in a folder. Its path.
pub fn write_report(folder: &Path) -> anyhow::Result<PathBuf> {
    let path = folder.join("report.html");
    let page = report::page(folder, &sections(folder)?)?;
    format::write_file(&path, page.as_bytes())?;
    Ok(path)
}

fn create(folder: &Path) -> anyhow::Result<()> {
    Ok(display::create_folder(folder)?)
}

/// Versions, machine and random numbers.
fn provenance(settings: &Settings, renderer: &Renderer) -> Vec<(String, String)> {
    let processor = std::fs::read_to_string("/proc/cpuinfo")
        .ok()
        .and_then(|text| {
            let line = text.lines().find(|line| line.starts_with("model name"))?;
            Some(line.split_once(':')?.1.trim().to_owned())
        });
    let [width, height] = settings.size;
    let entries = [
        ("Relight", env!("CARGO_PKG_VERSION").to_owned()),
        ("commit", env!("RELIGHT_COMMIT").to_owned()),
        ("wgpu", env!("RELIGHT_WGPU").to_owned()),
        ("device", renderer.name().to_owned()),
        (
            "processor",
            processor.unwrap_or_else(|| std::env::consts::ARCH.to_owned()),
        ),
        ("threads", rayon::current_num_threads().to_string()),
        ("pictures", format!("{width}x{height}")),
        ("truth samples per pixel", settings.samples.to_string()),
        ("seed", truth::SEED.to_string()),
    ];
    entries.map(|(key, value)| (key.to_owned(), value)).into()
}

/// Scene files; `$DATA` in them is the folder of data.
const SCENES: [(&str, &str); 13] = [
    ("teapot", include_str!("../../scenes/teapot.toml")),
    ("duck", include_str!("../../scenes/duck.toml")),
    ("spot", include_str!("../../scenes/spot.toml")),
    ("bunny", include_str!("../../scenes/bunny.toml")),
    ("walk_1", include_str!("../../scenes/walk_1.toml")),
    ("armadillo", include_str!("../../scenes/armadillo.toml")),
    ("dragon_100k", include_str!("../../scenes/dragon_100k.toml")),
    (
        "FlightHelmet",
        include_str!("../../scenes/FlightHelmet.toml"),
    ),
    (
        "gold_armadillo",
        include_str!("../../scenes/gold_armadillo.toml"),
    ),
    (
        "brushed_walk_1",
        include_str!("../../scenes/brushed_walk_1.toml"),
    ),
    ("white_bunny", include_str!("../../scenes/white_bunny.toml")),
    ("grey_bunny", include_str!("../../scenes/grey_bunny.toml")),
    ("gold_suzi", include_str!("../../scenes/gold_suzi.toml")),
];

/// Environment maps in the folder of data.
const ENVIRONMENTS: [(&str, &str); 4] = [
    ("grace", "env/debevec/grace_latlong.hdr"),
    ("stpeters", "env/debevec/stpeters_latlong.hdr"),
    ("studio", "env/polyhaven/studio.hdr"),
    ("lobby", "env/polyhaven/lobby.hdr"),
];

fn known<'a>(list: &[(&str, &'a str)], name: &str) -> anyhow::Result<&'a str> {
    let found = list.iter().find(|(known, _)| *known == name);
    Ok(found
        .with_context(|| format!("{name}: not a name of the laboratory"))?
        .1)
}

/// Writes one of the laboratory's scene files, with what it refers to, for people to open and
/// for [`load::load`].
fn scene_file(name: &str, folder: &Path, data: &Path) -> anyhow::Result<PathBuf> {
    write_scene_file(name, known(&SCENES, name)?, folder, data)
}

/// The same of any text.
fn write_scene_file(name: &str, text: &str, folder: &Path, data: &Path) -> anyhow::Result<PathBuf> {
    let data = data
        .canonicalize()
        .map_err(|source| Error::refused(data, "--data", "a folder that can be read", source))?;
    let text = text.replace("$DATA", &data.to_string_lossy());
    let folder = folder.join("scenes");
    create(&folder)?;
    if text.contains("stain.png") {
        edits::write_stain(&folder.join("stain.png"))?;
    }
    let path = folder.join(name).with_extension("toml");
    format::write_file(&path, text.as_bytes())?;
    Ok(path)
}

/// An environment as image, and as sources and lobes.
struct Light {
    image: LatLong,
    environment: Environment,
    lobes: Vec<SphericalGaussian>,
    /// What the image has beyond the lobes.
    beyond: Option<Prefiltered>,
    sources: Option<Sources>,
}

impl Light {
    /// One of [`ENVIRONMENTS`].
    fn new(
        data: &Path,
        name: &str,
        options: &FitOptions,
        monitor: Monitor,
    ) -> anyhow::Result<Self> {
        let image = hdr::load(&data.join(known(&ENVIRONMENTS, name)?))?;
        Self::of(image, options, monitor)
    }

    fn of(image: LatLong, options: &FitOptions, monitor: Monitor) -> anyhow::Result<Self> {
        let environment = environment::fit(&image, options, monitor)?.environment;
        let lobes: Vec<_> = environment.lobes.iter().map(Into::into).collect();
        Ok(Self {
            beyond: Prefiltered::new(&environment.prefiltered, &lobes),
            lobes,
            sources: Sources::new(&environment),
            image,
            environment,
        })
    }

    /// A frame under its light alone.
    fn frame(&self, camera: Camera) -> Frame<'_> {
        Frame {
            sources: self.sources.as_ref(),
            ..Frame::new(camera, &self.lobes)
        }
    }
}

/// The three that are always compared; the baseline first.
const METHODS: [(&str, Method); 3] = [
    ("ambient", Method::Ambient),
    ("cells", Method::Cells(CellsOptions::STANDARD)),
    ("polar", Method::Polar(PolarOptions::STANDARD)),
];

/// What experiments have to work with. Scenes and environments that several of them use are baked
/// once.
pub struct Laboratory<'a> {
    settings: Settings,
    /// Of the experiment.
    folder: PathBuf,
    renderer: Renderer,
    monitor: Monitor<'a>,
    scenes: BTreeMap<String, Rc<Scene>>,
    environments: BTreeMap<(String, Option<usize>), Rc<Light>>,
}

impl<'a> Laboratory<'a> {
    /// Draws with `renderer`.
    pub fn new(settings: Settings, renderer: Renderer, monitor: Monitor<'a>) -> Self {
        Self {
            folder: settings.folder.clone(),
            settings,
            renderer,
            monitor,
            scenes: BTreeMap::new(),
            environments: BTreeMap::new(),
        }
    }

    /// Runs one experiment; writes its folder and `section.json` in it.
    pub fn run(&mut self, experiment: &Experiment) -> anyhow::Result<Section> {
        self.folder = self.settings.folder.join(experiment.name);
        create(&self.folder)?;
        let mut section = Section {
            name: experiment.name.to_owned(),
            title: experiment.title.to_owned(),
            command: self.settings.command.clone(),
            provenance: provenance(&self.settings, &self.renderer),
            ..Section::default()
        };
        let start = Instant::now();
        (experiment.run)(self, &mut section)?;
        section.seconds = start.elapsed().as_secs_f64();
        for table in &section.tables {
            let path = self.folder.join(&table.name).with_extension("csv");
            format::write_file(&path, table.csv().as_bytes())?;
        }
        let text = serde_json::to_string_pretty(&section)?;
        format::write_file(&self.folder.join("section.json"), text.as_bytes())?;
        Ok(section)
    }

    /// One of [`SCENES`] as an input.
    fn input(&self, name: &str) -> anyhow::Result<SceneInput> {
        let path = scene_file(name, &self.settings.folder, &self.settings.data)?;
        // It names the folder of data.
        let files = Files::new(&path, &Access::anywhere())?;
        Ok(load::load_from(&files, &path)?)
    }

    /// One of [`SCENES`], baked.
    fn scene(&mut self, name: &str) -> anyhow::Result<Rc<Scene>> {
        if let Some(scene) = self.scenes.get(name) {
            return Ok(scene.clone());
        }
        let scene = Rc::new(self.bake(self.input(name)?, &self.settings.bake)?);
        self.scenes.insert(name.to_owned(), scene.clone());
        Ok(scene)
    }

    /// Bakes, writes and reads back.
    fn bake(&self, input: SceneInput, options: &scene::Options) -> anyhow::Result<Scene> {
        let name = input.name.clone();
        let (baked, _) = scene::bake(input, options, self.monitor).context(name.clone())?;
        let folder = self.settings.folder.join("assets");
        create(&folder)?;
        let bytes = format::write_scene(&baked)?;
        format::write_file(&folder.join(name).with_extension("relight"), &bytes)?;
        Ok(format::read_scene(&bytes, &Limits::default())?)
    }

    /// One of [`ENVIRONMENTS`], by lobes alone.
    fn light(&mut self, name: &str, lobes: usize) -> anyhow::Result<Rc<Light>> {
        self.light_of(name, Some(lobes))
    }

    /// One of [`ENVIRONMENTS`], as `bake environment` fits it by default.
    fn default_light(&mut self, name: &str) -> anyhow::Result<Rc<Light>> {
        self.light_of(name, None)
    }

    fn light_of(&mut self, name: &str, lobes: Option<usize>) -> anyhow::Result<Rc<Light>> {
        let key = (name.to_owned(), lobes);
        if let Some(light) = self.environments.get(&key) {
            return Ok(light.clone());
        }
        let data = &self.settings.data;
        let options = match lobes {
            Some(lobes) => FitOptions {
                sources: 0,
                ..FitOptions::with_lobes(lobes)
            },
            None => FitOptions::default(),
        };
        let light = Rc::new(Light::new(data, name, &options, self.monitor)?);
        self.environments.insert(key, light.clone());
        Ok(light)
    }

    fn draw(&mut self, scene: &Scene, frame: &Frame) -> anyhow::Result<Image> {
        Ok(self.renderer.render(scene, frame, self.settings.size)?)
    }

    fn time(&mut self, scene: &Scene, frame: &Frame) -> anyhow::Result<Timed> {
        self.monitor.step("render", 0.0)?;
        bench::draw(scene, frame, &mut self.renderer, self.settings.size, 1)
    }

    /// With the lobes of the frame.
    fn truth(&self, scene: &Scene, frame: &Frame) -> anyhow::Result<Image> {
        self.trace(scene, frame, Visibility::Exact, truth::SEED)
    }

    fn trace(
        &self,
        scene: &Scene,
        frame: &Frame,
        visibility: Visibility,
        seed: u32,
    ) -> anyhow::Result<Image> {
        self.monitor.step("trace truth", 0.0)?;
        let Settings { size, samples, .. } = self.settings;
        let options = truth::Options {
            seed,
            ..truth::Options::centers(samples)
        };
        Ok(lobes::of_frame(
            scene,
            frame,
            size,
            &options,
            visibility,
            &|| (),
        ))
    }

    /// Writes images side by side, all at the exposure of the last one.
    fn strip(
        &self,
        section: &mut Section,
        name: &str,
        caption: &str,
        images: &[&Image],
    ) -> anyhow::Result<()> {
        let last = images.last().context("a strip of images")?;
        let exposure = display::automatic_exposure(last);
        let (width, pixels) = display::side_by_side(images, exposure);
        self.picture(section, name, caption, width, &pixels)
    }

    fn picture(
        &self,
        section: &mut Section,
        name: &str,
        caption: &str,
        width: u32,
        pixels: &[[u8; 3]],
    ) -> anyhow::Result<()> {
        let file = format!("{name}.png");
        image_file::write_png(&self.folder.join(&file), width, pixels)?;
        section.figures.push(Figure {
            file,
            caption: caption.to_owned(),
        });
        Ok(())
    }

    /// A plot; or a sentence, where nothing is above zero, as errors are not that noise may explain.
    fn plot(
        &self,
        section: &mut Section,
        name: &str,
        caption: &str,
        axes: [&str; 2],
        curves: &[relight_bake::internals::plot::Curve],
    ) -> anyhow::Result<()> {
        let Some(svg) = relight_bake::internals::plot::svg(caption, axes, curves) else {
            let sentence = format!("No plot of {caption}: nothing in it is above noise.");
            section.text.push(sentence);
            return Ok(());
        };
        let file = format!("{name}.svg");
        format::write_file(&self.folder.join(&file), svg.as_bytes())?;
        section.figures.push(Figure {
            file,
            caption: caption.to_owned(),
        });
        Ok(())
    }
}

fn camera(scene: &Scene) -> anyhow::Result<Camera> {
    (scene.camera).with_context(|| format!("{}: expected a camera, found none", scene.name))
}

/// Relative RMSE, noise removed.
fn error(candidate: &Image, truth: &Image) -> anyhow::Result<f64> {
    Ok(compare(candidate, truth)?.noiseless())
}

/// The same for a table, percent.
fn percent(candidate: &Image, truth: &Image) -> anyhow::Result<Cell> {
    Ok(percent_of(&compare(candidate, truth)?))
}

/// How far off something is, percent: a bound where noise may explain all of it.
fn percent_of(found: &Comparison) -> Cell {
    found.below_noise().map_or_else(
        || (100.0 * found.noiseless()).into(),
        |most| Cell::below(100.0 * most),
    )
}

/// |a − b| with the coverage of `b`, `scale` times.
fn difference(a: &Image, b: &Image, scale: f32) -> Image {
    let pixels = a.pixels.iter().zip(&b.pixels).map(|(a, b)| {
        let [r, g, blue] = [0, 1, 2].map(|channel| scale * (a[channel] - b[channel]).abs());
        [r, g, blue, b[3]]
    });
    Image {
        width: b.width,
        height: b.height,
        pixels: pixels.collect(),
        variance: None,
    }
}
