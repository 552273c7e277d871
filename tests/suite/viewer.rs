//! The viewer, driven as a person would: by pointer, keys, files and names of widgets.

use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex, OnceLock, PoisonError};
use std::time::{Duration, Instant};

use eframe::egui_wgpu;
use egui::accesskit::Role;
use egui::{Key, Modifiers, PointerButton, Pos2, Vec2};
use egui_kittest::kittest::Queryable as _;
use egui_kittest::{Harness, TestRenderer};
use glam::Vec3;
use libtest_mimic::Trial;
use relight_format::{Environment, Scene};
use relight_runtime::offscreen::Gpu;
use relight_runtime::wgpu;
use relight_viewer::app::{Message, Start, Viewer};
use relight_viewer::dialog::Purpose;
use relight_viewer::engine::Device;
use relight_viewer::jobs::{self, Loaded};
use relight_viewer::state::{Background, Integrator, Layout, Quality, Settings};

use crate::support::{Outcome, with_data, with_display, with_gpu};

/// Size of the window, points and pixels.
const WINDOW: [f32; 2] = [900.0, 600.0];
/// The same of the one that is painted, and drawn with all its pixels.
const PAINTED: [u32; 2] = [640, 400];
/// How long anything may take: the machine may be busy.
const PATIENCE: Duration = Duration::from_mins(2);

pub fn trials() -> Vec<Trial> {
    vec![
        Trial::test("viewer::hands_turn_the_camera_and_the_light", hands),
        Trial::test("viewer::clicks_select_and_edits_show", edits),
        Trial::test("viewer::shadows_are_caught_alone", shadows_alone),
        Trial::test(
            "viewer::two_pictures_have_a_divider_and_a_difference",
            two_pictures,
        ),
        Trial::test(
            "viewer::coarse_pictures_come_first_and_old_requests_end",
            progressive,
        ),
        Trial::test("viewer::input_is_answered_by_few_pixels", answers),
        Trial::test("viewer::jobs_are_cancelled_by_their_button", cancelling),
        Trial::test("viewer::dialogs_bring_files_or_nothing", dialogs),
        Trial::test("viewer::bounces_are_switched_off", bounces),
        Trial::test("viewer::fingers_turn_and_pinch", fingers),
        Trial::test("viewer::what_is_saved_can_be_opened", saving),
        Trial::test("viewer::broken_files_are_messages", broken_files),
        Trial::test("viewer::files_that_change_are_read_again", reload),
        Trial::test("viewer::pictures_without_a_window", without_window),
        with_data("viewer::real_broken_files_are_messages", real_broken_files),
        with_data("viewer::drops_are_opened", drops),
        with_data("viewer::measured_materials_show_their_table", measured),
        with_gpu("viewer::window_on_software_vulkan", on_vulkan),
        with_display("viewer::a_window_on_a_screen", on_screen),
    ]
}

fn start() -> Start {
    Start {
        device: Device::Cpu,
        settings: Some(Settings {
            quality: Quality::Draft,
            lobes: 8,
            // One pixel of 25, or drawing would take most of the time.
            resolution: 0.2,
            ..Settings::default()
        }),
        ..Start::default()
    }
}

/// The built-in scene baked once, for a bake for every trial would take longer than all trials, and
/// light without sources, whose rays would take most of the time.
pub fn prepared_assets() -> (Arc<Scene>, Environment) {
    static SCENE: OnceLock<Arc<Scene>> = OnceLock::new();
    let scene = SCENE.get_or_init(|| {
        let loaded = jobs::collect(|context| jobs::built_in_scene(&[Quality::Draft], context));
        match loaded.as_deref() {
            Ok([Loaded::Scene { scene, .. }]) => scene.clone(),
            _ => panic!("what is built in can be baked"),
        }
    });
    let lobe = |axis, sharpness, amplitude| relight_format::Lobe {
        axis,
        sharpness,
        amplitude,
        ..bytemuck::Zeroable::zeroed()
    };
    let environment = Environment {
        lobes: vec![
            lobe([0.0, 1.0, 0.0], 2.0, [0.3, 0.35, 0.4]),
            lobe([0.6, 0.64, 0.48], 60.0, [9.0, 8.0, 6.0]),
        ],
        ..Environment::default()
    };
    (scene.clone(), environment)
}

/// Opens both.
fn start_prepared() -> Start {
    static FILES: OnceLock<(tempfile::TempDir, [PathBuf; 2])> = OnceLock::new();
    let (_, files) = FILES.get_or_init(|| {
        let folder = tempfile::tempdir().expect("a folder");
        let (scene, environment) = prepared_assets();
        let bytes = [
            relight_format::write_scene(&scene),
            relight_format::write_environment(&environment),
        ];
        let files = ["scene.relight", "light.relight"].map(|name| folder.path().join(name));
        for (file, bytes) in files.iter().zip(bytes) {
            std::fs::write(file, bytes.expect("an asset")).expect("a file");
        }
        (folder, files)
    });
    Start {
        files: files.to_vec(),
        ..start()
    }
}

type Window = Harness<'static, Lazy>;

/// A viewer that starts with the harness's first frame, whose context it needs.
struct Lazy {
    start: Start,
    viewer: Option<Viewer>,
}

impl Lazy {
    fn show(&mut self, ui: &mut egui::Ui) {
        let start = &self.start;
        self.viewer
            .get_or_insert_with(|| Viewer::new(ui.ctx(), start))
            .show(ui);
    }
}

impl std::ops::Deref for Lazy {
    type Target = Viewer;

    fn deref(&self) -> &Viewer {
        self.viewer.as_ref().expect("a first frame")
    }
}

impl std::ops::DerefMut for Lazy {
    fn deref_mut(&mut self) -> &mut Viewer {
        self.viewer.as_mut().expect("a first frame")
    }
}

/// A window of the viewer, without a screen.
fn window(start: &Start) -> Window {
    let lazy = Lazy {
        start: start.clone(),
        viewer: None,
    };
    Harness::builder()
        .with_size(WINDOW)
        .with_step_dt(1.0 / 60.0)
        .build_ui_state(|ui, lazy: &mut Lazy| lazy.show(ui), lazy)
}

/// Frames until the condition holds.
fn until(window: &mut Window, what: &str, condition: impl Fn(&Viewer) -> bool) -> Outcome {
    let start = Instant::now();
    loop {
        window.step();
        if condition(window.state()) {
            return Ok(());
        }
        if start.elapsed() > PATIENCE {
            return Err(format!("{what}; messages: {:?}", window.state().messages).into());
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}

fn settle(window: &mut Window) -> Outcome {
    // What was just asked for has to be noticed first.
    window.step();
    until(window, "pictures are finished", Viewer::is_settled)
}

/// The scene that a window shows.
fn scene_of(window: &Window) -> Result<Arc<Scene>, libtest_mimic::Failed> {
    let document = window.state().document.as_ref().ok_or("a scene")?;
    Ok(document.scene.clone())
}

/// The window with the built-in scene drawn.
fn settled_window() -> Result<Window, libtest_mimic::Failed> {
    let mut window = window(&start_prepared());
    settle(&mut window)?;
    Ok(window)
}

fn pixels(window: &Window) -> Vec<u8> {
    window
        .state()
        .screen()
        .map(|(_, pixels)| pixels.clone())
        .unwrap_or_default()
}

/// Middle of the picture.
fn middle(window: &Window) -> Pos2 {
    window.get_by_label("picture of the scene").rect().center()
}

/// Presses, moves in steps and releases.
fn drag(window: &mut Window, from: Pos2, by: Vec2, button: PointerButton, modifiers: Modifiers) {
    let event = |window: &Window, event| window.event_modifiers(event, modifiers);
    let press = |pos, pressed| egui::Event::PointerButton {
        pos,
        button,
        pressed,
        modifiers,
    };
    event(window, egui::Event::PointerMoved(from));
    window.step();
    event(window, press(from, true));
    window.step();
    for part in 1..=4 {
        event(
            window,
            egui::Event::PointerMoved(from + by * part as f32 / 4.0),
        );
        window.step();
    }
    event(window, press(from + by, false));
    window.step();
}

/// Brings a widget into sight and clicks it.
fn click(window: &mut Window, role: Role, label: &str) {
    window.get_by_role_and_label(role, label).scroll_to_me();
    window.run_steps(20);
    window.get_by_role_and_label(role, label).click();
    window.run_steps(3);
}

fn hands() -> Outcome {
    let mut window = settled_window()?;
    let (still, orbit) = (pixels(&window), window.state().orbit);
    let middle = middle(&window);
    let step = Vec2::new(60.0, 0.0);
    drag(
        &mut window,
        middle,
        step,
        PointerButton::Primary,
        Modifiers::NONE,
    );
    let turned = window.state().orbit;
    assert!(
        turned.yaw < orbit.yaw && turned.target == orbit.target,
        "{turned:?}"
    );
    settle(&mut window)?;
    assert_ne!(still, pixels(&window));

    drag(
        &mut window,
        middle,
        step,
        PointerButton::Secondary,
        Modifiers::NONE,
    );
    let panned = window.state().orbit;
    assert!(
        panned.target != turned.target && panned.yaw == turned.yaw,
        "{panned:?}"
    );

    let yaw = window.state().turn.yaw;
    drag(
        &mut window,
        middle,
        step,
        PointerButton::Primary,
        Modifiers::CTRL,
    );
    assert!(window.state().turn.yaw > yaw);
    assert_eq!(window.state().orbit, panned);

    window.event(egui::Event::PointerMoved(middle));
    window.event(egui::Event::MouseWheel {
        unit: egui::MouseWheelUnit::Point,
        delta: Vec2::new(0.0, 120.0),
        phase: egui::TouchPhase::Move,
        source: egui::MouseWheelSource::Wheel,
        modifiers: Modifiers::NONE,
    });
    window.run_steps(20);
    assert!(window.state().orbit.distance < panned.distance);

    window.key_press(Key::F);
    window.step();
    let framed = window.state().orbit;
    let (low, high) = window.state().document.as_ref().ok_or("a scene")?.bounds;
    assert!(
        framed.target.distance(0.5 * (low + high)) < 1e-4,
        "{framed:?}"
    );
    window.key_press(Key::ArrowLeft);
    window.step();
    assert!(window.state().orbit.yaw != framed.yaw);

    window.get_by_label("Turn the light").click();
    window.run_steps(8);
    let yaw = window.state().turn.yaw;
    window.run_steps(8);
    assert!(window.state().turn.yaw != yaw, "the light plays");
    window.get_by_label("Stop the light").click();
    settle(&mut window)
}

fn edits() -> Outcome {
    let mut window = settled_window()?;
    let before = pixels(&window);
    let at = middle(&window);
    drag(
        &mut window,
        at,
        Vec2::ZERO,
        PointerButton::Primary,
        Modifiers::NONE,
    );
    window.step();
    let selected = window
        .state()
        .document
        .as_ref()
        .and_then(|document| document.selected);
    let selected = selected.ok_or("the middle of the picture is of something")?;
    // By name: another model.
    click(&mut window, Role::ComboBox, "reflection");
    window.get_by_label("Ward").click();
    window.run_steps(3);
    let surface = |window: &Window| {
        let document = window.state().document.as_ref().expect("a scene");
        format!("{:?}", document.materials[selected].surface)
    };
    assert!(surface(&window).contains("Ward"), "{}", surface(&window));
    settle(&mut window)?;
    let edited = pixels(&window);
    assert_ne!(before, edited);
    click(&mut window, Role::Button, "Undo changes");
    settle(&mut window)?;
    assert!(before == pixels(&window), "undone");

    // The inspector looks at the point.
    window.get_by_label("Inspect").click();
    window.run_steps(2);
    drag(
        &mut window,
        at,
        Vec2::ZERO,
        PointerButton::Primary,
        Modifiers::NONE,
    );
    let (inspection, _) = window.state().inspection.as_ref().ok_or("an inspection")?;
    let known: Vec<f32> = inspection
        .distances
        .iter()
        .copied()
        .filter(|distance| !distance.is_nan())
        .collect();
    assert!(
        known.iter().any(|distance| *distance > 0.0),
        "something is visible"
    );
    assert!(!inspection.lights.is_empty());
    Ok(())
}

/// The ground's shadow alone: what is saved has its coverage.
fn shadows_alone() -> Outcome {
    let mut window = settled_window()?;
    window.state_mut().settings.background = Background::Transparent;
    let document = window.state_mut().document.as_mut().ok_or("a scene")?;
    let names = document.materials.iter().map(|material| &material.name);
    document.selected = names.clone().position(|name| name == "ground");
    assert!(
        document.selected.is_some(),
        "{:?}",
        names.collect::<Vec<_>>()
    );
    settle(&mut window)?;
    let partly = |coverage: f32| coverage > 0.05 && coverage < 0.95;
    let count = |window: &Window| {
        let pixels = pixels(window);
        let coverages = pixels.chunks(4).map(|pixel| f32::from(pixel[3]) / 255.0);
        coverages.filter(|coverage| partly(*coverage)).count()
    };
    assert_eq!(count(&window), 0);
    click(&mut window, Role::CheckBox, "Catches shadows alone");
    settle(&mut window)?;
    let shadowed = count(&window);
    assert!(shadowed > 500, "{shadowed} pixels");

    let folder = tempfile::tempdir()?;
    let [png, exr] = ["shadow.png", "shadow.exr"].map(|name| folder.path().join(name));
    for path in [&png, &exr] {
        window.state_mut().chosen(&Purpose::SavePicture, path);
    }
    let saved = image::open(&png)?.into_rgba8();
    let partly_of_png = (saved.pixels())
        .filter(|pixel| partly(f32::from(pixel[3]) / 255.0))
        .count();
    assert_eq!(partly_of_png, shadowed);
    let linear = relight_lab::image_file::read_exr(&exr)?;
    let partly_of_exr = (linear.pixels.iter())
        .filter(|pixel| partly(pixel[3]))
        .count();
    assert!(partly_of_exr > 500, "{partly_of_exr} pixels");
    Ok(())
}

fn two_pictures() -> Outcome {
    let mut window = settled_window()?;
    window.get_by_label("Split").click();
    settle(&mut window)?;
    let split = pixels(&window);
    let size = window.state().screen().ok_or("pixels")?.0;
    // Right of the divider is `ambient`: the pictures differ, and the left is as before.
    let [left, right] = [0, 1].map(|pane: usize| window.state().pictures[pane].clone());
    let (left, right) = (left.ok_or("left")?, right.ok_or("right")?);
    assert_eq!([left.image.width, left.image.height], size);
    assert_ne!(left.image.pixels, right.image.pixels);
    let divider = window.get_by_label("divider").rect().center();
    let grip = divider + Vec2::new(0.0, 80.0);
    drag(
        &mut window,
        grip,
        Vec2::new(-100.0, 0.0),
        PointerButton::Primary,
        Modifiers::NONE,
    );
    assert!(
        window.state().settings.divider < 0.4,
        "{}",
        window.state().settings.divider
    );
    settle(&mut window)?;
    assert_ne!(split, pixels(&window));

    window.get_by_label("Difference").click();
    settle(&mut window)?;
    let different = pixels(&window);
    assert!(
        different
            .chunks(4)
            .any(|pixel| pixel[..3].iter().any(|value| *value > 8))
    );
    window.state_mut().settings.integrators = [Integrator::Ambient; 2];
    settle(&mut window)?;
    let same = pixels(&window);
    assert!(
        same.chunks(4).all(|pixel| pixel == [0, 0, 0, 255]),
        "equal pictures are black"
    );

    // The ray tracer joins, and gets better.
    window.state_mut().settings.integrators = [Integrator::Polar, Integrator::Truth];
    window.step();
    until(&mut window, "two passes", |viewer| {
        viewer.pictures[1]
            .as_ref()
            .is_some_and(|picture| picture.samples >= 16)
    })?;
    assert_eq!(window.state().settings.layout, Layout::Difference);
    Ok(())
}

/// Counts, not seconds: whether others use the machine is not the viewer's doing.
fn progressive() -> Outcome {
    use relight_viewer::engine::{Engine, Event, Request};

    let window = settled_window()?;
    let slow = window.state().shot(Integrator::Cells).ok_or("a shot")?;
    let fast = window.state().shot(Integrator::Ambient).ok_or("a shot")?;
    let engine = Engine::new(Device::Cpu, || ());
    let request = |shot| Request {
        shots: vec![shot],
        size: [400, 300],
        progressive: true,
    };
    let slow = engine.request(request(slow));
    let wait = |found: &mut dyn FnMut(&Event) -> bool| -> Outcome {
        let start = Instant::now();
        while start.elapsed() < PATIENCE {
            for event in engine.events() {
                if found(&event) {
                    return Ok(());
                }
            }
            std::thread::sleep(Duration::from_millis(1));
        }
        Err("nothing came".into())
    };
    let mut first = None;
    wait(&mut |event| {
        let Event::Picture(picture) = event else {
            return false;
        };
        first = Some(picture.clone());
        true
    })?;
    let first = first.ok_or("a picture")?;
    assert_eq!(first.request, slow);
    assert!(first.image.width < 100 && first.draft && !first.complete);
    // The best picture by cells would take many seconds; another request ends it.
    let fast = engine.request(request(fast));
    let mut of_slow = 0;
    wait(&mut |event| {
        let Event::Picture(picture) = event else {
            return false;
        };
        if picture.request == slow {
            of_slow += 1;
            assert!(!picture.complete, "nobody wants it any more");
        }
        picture.request == fast && picture.complete
    })?;
    assert!(
        of_slow <= 1,
        "{of_slow} pictures after the request was replaced"
    );
    Ok(())
}

/// What makes answers quick, as counts: small first pictures, and scenes that are prepared once.
fn answers() -> Outcome {
    let mut window = settled_window()?;
    let preparations = |window: &Window| {
        let picture = window.state().pictures[0].as_ref();
        picture.map_or(0, |picture| picture.preparations)
    };
    assert_eq!(preparations(&window), 1);
    // As on a device that takes long, whatever this one is.
    window.state_mut().settings.resolution = 1.0;
    let inputs: [fn(&mut Viewer); 7] = [
        |viewer| viewer.settings.integrators[0] = Integrator::Truth,
        |viewer| viewer.orbit = viewer.orbit.turned(0.05, 0.0),
        |viewer| viewer.settings.integrators[0] = Integrator::Cells,
        |viewer| viewer.orbit = viewer.orbit.turned(0.05, 0.0),
        |viewer| viewer.turn.yaw += 0.1,
        |viewer| {
            if let Some(document) = &mut viewer.document {
                Arc::make_mut(&mut document.materials)[0].emission = [0.25; 3];
            }
        },
        |viewer| viewer.settings.layout = Layout::Split,
    ];
    for (index, input) in inputs.into_iter().enumerate() {
        let before = window.state().answers.len();
        // Under way or not: nobody waits for the last picture.
        input(window.state_mut());
        until(&mut window, "an answer", |viewer| {
            viewer.answers.len() > before
        })?;
        // What is on the screen by now may be better: windows may be slower than pictures.
        let answer = window.state().answers.last().ok_or("an answer")?;
        let first = answer.first[0].ok_or("its first picture")?;
        let pixels = first.size[0] * first.size[1];
        assert!(
            first.draft && !first.complete && pixels < 30_000,
            "{index}: {first:?}"
        );
        let [composed, shown] = [answer.composed, answer.shown].map(|[x, y]| x * y);
        assert!(composed <= shown, "as few are composed: {answer:?}");
        assert_eq!(preparations(&window), 1, "{index}");
    }
    println!("answers: {:?}", window.state().answers);
    Ok(())
}

/// A mesh whose bake takes long enough to be cancelled.
fn cancelling() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("many.obj");
    let mut text = String::new();
    for table in 0..60 {
        for line in TABLE.lines() {
            let numbers: Vec<f32> = line[1..].split_whitespace().flat_map(str::parse).collect();
            match (line.split_whitespace().next(), &numbers[..]) {
                (Some("v"), [x, y, z]) => {
                    text += &format!(
                        "v {} {y} {}\n",
                        x + 3.0 * (table % 8) as f32,
                        z + 3.0 * (table / 8) as f32
                    );
                }
                (Some("f"), corners) => {
                    let corners: Vec<String> = (corners.iter())
                        .map(|corner| (*corner as usize + 12 * table).to_string())
                        .collect();
                    text += &format!("f {}\n", corners.join(" "));
                }
                _ => {}
            }
        }
    }
    std::fs::write(&mesh, text)?;
    let mut window = settled_window()?;
    let before = scene_of(&window)?;
    window.state_mut().settings.quality = Quality::High;
    window.state_mut().open(&mesh);
    window.step();
    let running = window.state().jobs.running().len();
    assert_eq!(running, 1);
    until(&mut window, "the bake is under way", |viewer| {
        (viewer.jobs.running().first()).is_none_or(|job| job.status().fraction > 0.0)
    })?;
    assert!(
        window.query_by_label_contains("many.obj").is_some(),
        "its name is shown"
    );
    window.get_by_label("Cancel").click();
    window.run_steps(3);
    assert!(window.state().jobs.running().is_empty());
    assert!(window.query_by_label("Cancel").is_none());
    let after = scene_of(&window)?;
    assert!(
        Arc::ptr_eq(&before, &after),
        "what was shown is still shown"
    );
    assert!(
        window
            .state()
            .messages
            .iter()
            .all(|message| !message.is_error)
    );
    // Its thread ends; another bake takes its place.
    std::fs::write(&mesh, TABLE)?;
    window.state_mut().settings.quality = Quality::Draft;
    window.state_mut().open(&mesh);
    until(&mut window, "the next bake", |viewer| {
        viewer
            .document
            .as_ref()
            .is_some_and(|document| document.source.is_some())
    })
}

/// Menus ask for files; what comes of it, later or never, is taken as dialogs give it.
fn dialogs() -> Outcome {
    let folder = tempfile::tempdir()?;
    let picture = folder.path().join("picture.png");
    let asked: Arc<Mutex<Vec<Purpose>>> = Arc::default();
    let mut window = settled_window()?;
    let (inbox, answer) = (asked.clone(), picture.clone());
    window.state_mut().dialog = Box::new(move |purpose, _, answered| {
        inbox
            .lock()
            .unwrap_or_else(PoisonError::into_inner)
            .push(purpose.clone());
        match purpose {
            // Somebody closes the dialog.
            Purpose::Open => answered(None),
            _ => answered(Some(answer.clone())),
        }
    });
    let choose = |window: &mut Window, item: &str| {
        window.get_by_label("File").click();
        window.run_steps(3);
        // The menu lies above the panel, which has buttons of the same name.
        let items: Vec<_> = window.get_all_by_label(item).collect();
        items.last().expect("an item").click();
        drop(items);
        window.run_steps(3);
    };
    choose(&mut window, "Open…");
    choose(&mut window, "Save picture…");
    let asked = asked.lock().unwrap_or_else(PoisonError::into_inner);
    assert!(
        matches!(asked[..], [Purpose::Open, Purpose::SavePicture]),
        "{asked:?}"
    );
    until(&mut window, "the picture is saved", |viewer| {
        viewer
            .messages
            .iter()
            .any(|message| message.text.contains("saved"))
    })?;
    let saved = image::open(&picture)?.into_rgba8();
    assert!(saved.as_raw() == &pixels(&window));
    assert!(
        window
            .state()
            .messages
            .iter()
            .all(|message| !message.is_error)
    );
    Ok(())
}

fn bounces() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mesh = folder.path().join("table.obj");
    std::fs::write(&mesh, TABLE)?;
    let settings = start().settings.map(|settings| Settings {
        quality: Quality::Standard,
        ..settings
    });
    let mut window = window(&Start {
        files: vec![mesh, start_prepared().files[1].clone()],
        settings,
        ..start()
    });
    settle(&mut window)?;
    let document = window.state().document.as_ref().ok_or("a scene")?;
    let bounces = document.scene.transfer.is_some();
    assert!(bounces, "the default bake has it");
    let with = pixels(&window);
    click(&mut window, Role::CheckBox, "Light that bounces");
    assert!(!window.state().settings.bounce);
    settle(&mut window)?;
    let without = pixels(&window);
    let sum = |pixels: &[u8]| pixels.iter().map(|value| u64::from(*value)).sum::<u64>();
    assert!(sum(&without) < sum(&with), "less light");
    click(&mut window, Role::CheckBox, "Light that bounces");
    settle(&mut window)?;
    assert!(with == pixels(&window), "and again as before");
    Ok(())
}

fn fingers() -> Outcome {
    let mut window = settled_window()?;
    let middle = middle(&window);
    let device = egui::TouchDeviceId(1);
    let touch = |window: &mut Window, id: u64, phase, pos: Pos2| {
        window.event(egui::Event::Touch {
            device_id: device,
            id: egui::TouchId(id),
            phase,
            pos,
            force: None,
        });
    };
    let orbit = window.state().orbit;
    // One finger: window systems make a pointer of it.
    touch(&mut window, 1, egui::TouchPhase::Start, middle);
    drag(
        &mut window,
        middle,
        Vec2::new(50.0, 0.0),
        PointerButton::Primary,
        Modifiers::NONE,
    );
    touch(&mut window, 1, egui::TouchPhase::End, middle);
    let turned = window.state().orbit;
    assert!(
        turned.yaw < orbit.yaw && turned.target == orbit.target,
        "{turned:?}"
    );
    window.run_steps(5);
    // Two fingers that part.
    let turned = window.state().orbit;
    let apart = |x: f32| [middle - Vec2::new(x, 0.0), middle + Vec2::new(x, 0.0)];
    window.event(egui::Event::PointerMoved(middle));
    for (id, at) in apart(30.0).into_iter().enumerate() {
        touch(&mut window, id as u64, egui::TouchPhase::Start, at);
    }
    window.step();
    for step in 1..=5u8 {
        for (id, at) in apart(30.0 + 10.0 * f32::from(step)).into_iter().enumerate() {
            touch(&mut window, id as u64, egui::TouchPhase::Move, at);
        }
        window.step();
    }
    let pinched = window.state().orbit;
    assert!(pinched.distance < 0.7 * turned.distance, "{pinched:?}");
    // Both move: the scene follows.
    for step in 1..=5u8 {
        for (id, at) in apart(80.0).into_iter().enumerate() {
            let moved = at + Vec2::new(0.0, 10.0 * f32::from(step));
            touch(&mut window, id as u64, egui::TouchPhase::Move, moved);
        }
        window.step();
    }
    let moved = window.state().orbit;
    assert!(moved.target != pinched.target, "{moved:?}");
    for (id, at) in apart(80.0).into_iter().enumerate() {
        touch(&mut window, id as u64, egui::TouchPhase::End, at);
    }
    settle(&mut window)
}

/// A dropped table looks as the same table baked into a scene.
fn measured(data: &Path) -> Outcome {
    let tables = std::fs::read_dir(data.join("brdf/rgl"))?;
    let table = (tables.flatten().map(|entry| entry.path()))
        .find(|path| path.extension().is_some_and(|ending| ending == "bsdf"))
        .ok_or("a table")?;
    let folder = tempfile::tempdir()?;
    let place = |name: &str| folder.path().join(name);
    std::fs::copy(&table, place("table.bsdf"))?;
    std::fs::write(place("table.obj"), TABLE)?;
    let named =
        "mesh = \"table.obj\"\n[materials.wood]\nmodel = \"measured\"\nfile = \"table.bsdf\"\n";
    std::fs::write(place("named.toml"), named)?;
    std::fs::write(place("plain.toml"), "mesh = \"table.obj\"\n")?;
    let light = start_prepared().files[1].clone();
    let open = |name: &str| -> Result<Window, libtest_mimic::Failed> {
        let mut window = window(&Start {
            files: vec![place(name), light.clone()],
            ..start()
        });
        settle(&mut window)?;
        Ok(window)
    };
    let expected = open("named.toml")?;
    let mut window = open("plain.toml")?;
    let plain = pixels(&window);
    window
        .state_mut()
        .document
        .as_mut()
        .ok_or("a scene")?
        .selected = Some(0);
    window.state_mut().open(&place("table.bsdf"));
    settle(&mut window)?;
    assert!(plain != pixels(&window));
    let shown = |window: &Window| {
        let picture = window.state().pictures[0].as_ref();
        picture.map(|picture| picture.image.clone())
    };
    let (found, baked) = (
        shown(&window).ok_or("a picture")?,
        shown(&expected).ok_or("a picture")?,
    );
    let apart = relight_viewer::compose::relative_difference(&found, &baked);
    let apart = apart.ok_or("pictures of something")?;
    // Light that bounces was baked with another material.
    assert!(apart < 0.02, "{apart}");
    // A scene file of it names the table and shows the same; so does an asset.
    for (purpose, name) in [
        (Purpose::SaveScene, "saved.toml"),
        (Purpose::SaveAsset, "saved.relight"),
    ] {
        window.state_mut().chosen(&purpose, &place(name));
        settle(&mut window)?;
        let errors = window
            .state()
            .messages
            .iter()
            .any(|message| message.is_error);
        assert!(!errors, "{:?}", window.state().messages);
    }
    assert!(std::fs::read_to_string(place("saved.toml"))?.contains("table.bsdf"));
    // A better bake keeps it.
    window.state_mut().bake_again();
    settle(&mut window)?;
    let again = shown(&window).ok_or("a picture")?;
    let apart = relight_viewer::compose::relative_difference(&again, &found);
    assert!(apart.is_some_and(|apart| apart < 1e-3), "{apart:?}");
    Ok(())
}

fn saving() -> Outcome {
    let folder = tempfile::tempdir()?;
    let path = |name: &str| folder.path().join(name);
    // A mesh to save a scene file of.
    std::fs::write(path("table.obj"), TABLE)?;
    let mut window = window(&Start {
        files: vec![path("table.obj"), start_prepared().files[1].clone()],
        ..start()
    });
    settle(&mut window)?;
    let light = relight_runtime::LocalLight {
        position: Vec3::new(0.0, 2.0, 0.5),
        radius: 0.1,
        radiance: Vec3::new(20.0, 10.0, 5.0),
        spot: None,
    };
    {
        let document = window.state_mut().document.as_mut().ok_or("a scene")?;
        document.local_lights.push(light);
        let material = &mut Arc::make_mut(&mut document.materials)[0];
        material.surface = relight_format::Surface::DiffuseSpecular {
            diffuse: [0.7, 0.2, 0.1],
            specular: relight_format::Specular::Ggx {
                f0: [0.04; 3],
                alpha: [0.25; 2],
            },
        };
    }
    settle(&mut window)?;
    let drawn = pixels(&window);
    for (purpose, name) in [
        (Purpose::SavePicture, "picture.png"),
        (Purpose::SavePicture, "picture.exr"),
        (Purpose::SaveCamera, "camera.toml"),
        (Purpose::SaveScene, "scene.toml"),
        (Purpose::SaveAsset, "scene.relight"),
    ] {
        window.state_mut().chosen(&purpose, &path(name));
    }
    settle(&mut window)?;
    let errors: Vec<_> = window
        .state()
        .messages
        .iter()
        .filter(|message| message.is_error)
        .collect();
    assert!(errors.is_empty(), "{errors:?}");

    let size = window.state().screen().ok_or("pixels")?.0;
    let picture = image::open(path("picture.png"))?.into_rgba8();
    assert_eq!([picture.width(), picture.height()], size);
    assert!(
        picture.as_raw() == &drawn,
        "an opaque picture is saved as it is shown"
    );
    let linear = relight_lab::image_file::read_exr(&path("picture.exr"))?;
    let shown = window.state().pictures[0]
        .as_ref()
        .ok_or("a picture")?
        .image
        .clone();
    assert!(linear.pixels == shown.pixels);
    let camera = relight_lab::camera::load(&path("camera.toml"))?;
    let expected = window.state().orbit.camera();
    assert!(Vec3::from(camera.position).distance(expected.position.into()) < 1e-5);

    // Scene file and asset show the same again.
    for name in ["scene.toml", "scene.relight"] {
        window.state_mut().open(&path(name));
        settle(&mut window)?;
        let document = window.state().document.as_ref().ok_or("a scene")?;
        assert_eq!(document.source.as_deref(), Some(path(name).as_path()));
        let name_of = &document.materials[0].name;
        let surface = format!("{:?}", document.materials[0].surface);
        assert!(surface.contains("0.25"), "{name}: {name_of:?} {surface}");
        if name == "scene.toml" {
            assert_eq!(document.local_lights.len(), 1);
            let found = window.state().orbit.camera();
            assert!(Vec3::from(found.position).distance(expected.position.into()) < 1e-3);
        }
    }
    Ok(())
}

/// A plate with a box on it.
const TABLE: &str = "\
o table
usemtl wood
v -1 0 -1
v 1 0 -1
v 1 0 1
v -1 0 1
v -0.3 0 -0.3
v 0.3 0 -0.3
v 0.3 0 0.3
v -0.3 0 0.3
v -0.3 0.6 -0.3
v 0.3 0.6 -0.3
v 0.3 0.6 0.3
v -0.3 0.6 0.3
f 4 3 2 1
f 12 11 10 9
f 8 7 11 12
f 7 6 10 11
f 6 5 9 10
f 5 8 12 9
";

fn expect_error(window: &mut Window, file: &Path) -> Outcome {
    window.state_mut().messages.clear();
    window.state_mut().open(file);
    until(window, "an answer", |viewer| {
        viewer.jobs.running().is_empty()
    })?;
    window.step();
    let messages = &window.state().messages;
    let name = file
        .file_name()
        .unwrap_or_default()
        .to_string_lossy()
        .into_owned();
    if messages
        .iter()
        .any(|message| message.is_error && message.text.contains(&name))
    {
        Ok(())
    } else {
        Err(format!("{}: {messages:?}", file.display()).into())
    }
}

fn broken_files() -> Outcome {
    let folder = tempfile::tempdir()?;
    let mut window = settled_window()?;
    let before = scene_of(&window)?;
    let asset = relight_format::write_scene(&before)?;
    let mut flipped = asset.clone();
    flipped[asset.len() / 2] ^= 0x20;
    let files: [(&str, &[u8]); 9] = [
        ("empty.relight", b""),
        ("short.relight", &asset[..asset.len() / 3]),
        ("flipped.relight", &flipped),
        ("text.toml", b"mesh = 7"),
        ("missing.toml", b"mesh = \"nowhere.obj\""),
        ("noise.glb", b"glTF\x02\0\0\0\xff\xff\xff\xff"),
        ("index.obj", b"v 0 0 0\nf 1 2 3\n"),
        ("noise.hdr", b"#?RADIANCE\n\n-Y 99999999 +X 99999999\n"),
        ("noise.exr", b"\x76\x2f\x31\x01rest"),
    ];
    for (name, bytes) in files {
        let file = folder.path().join(name);
        std::fs::write(&file, bytes)?;
        expect_error(&mut window, &file)?;
    }
    for name in ["nothing.relight", "picture.bmp", "folder"] {
        expect_error(&mut window, &folder.path().join(name))?;
    }
    let after = &window.state().document.as_ref().ok_or("a scene")?.scene;
    assert!(Arc::ptr_eq(&before, after), "what was shown is still shown");
    // They are seen as text.
    assert!(
        window.query_by_label_contains("picture.bmp").is_some()
            || !window.state().messages.is_empty()
    );
    Ok(())
}

fn real_broken_files(data: &Path) -> Outcome {
    let mut window = settled_window()?;
    let mut opened = 0;
    let mut folders = vec![data.join("meshes/awkward")];
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(&folder)? {
            let file = entry?.path();
            if file.is_dir() {
                folders.push(file);
                continue;
            }
            let is_mesh = ["obj", "gltf", "glb"]
                .iter()
                .any(|ending| file.extension().is_some_and(|found| found == *ending));
            if is_mesh && relight_bake::scene::load::load(&file).is_err() {
                opened += 1;
                expect_error(&mut window, &file)?;
                let defect = |message: &Message| message.text.contains("a defect of ours");
                assert!(
                    !window.state().messages.iter().any(defect),
                    "{}",
                    file.display()
                );
            }
        }
    }
    assert!(opened > 3, "{opened} files");
    Ok(())
}

/// What a window system hands over.
#[derive(Debug)]
struct Dropped(PathBuf);

impl egui::DroppedFile for Dropped {
    fn path(&self) -> &Path {
        &self.0
    }

    fn bytes(&self) -> Result<Vec<u8>, String> {
        std::fs::read(&self.0).map_err(|error| error.to_string())
    }
}

fn drops(data: &Path) -> Outcome {
    let mut window = settled_window()?;
    let before = pixels(&window);
    let drop = |window: &mut Window, path: PathBuf| {
        window
            .input_mut()
            .dropped_files
            .push(Arc::new(Dropped(path)));
        window.step();
    };
    drop(&mut window, data.join("env/probulator/wells_256.hdr"));
    settle(&mut window)?;
    assert_eq!(window.state().light.name, "wells_256.hdr");
    assert_ne!(before, pixels(&window));
    drop(&mut window, data.join("meshes/figures/suzanne_quads.obj"));
    settle(&mut window)?;
    let document = window.state().document.as_ref().ok_or("a scene")?;
    assert_eq!(document.scene.name, "suzanne_quads");
    // A measured material, for what is selected.
    window
        .state_mut()
        .document
        .as_mut()
        .ok_or("a scene")?
        .selected = Some(0);
    let tables = std::fs::read_dir(data.join("brdf/rgl"))?;
    let table = tables
        .flatten()
        .map(|entry| entry.path())
        .find(|path| path.extension().is_some_and(|ending| ending == "bsdf"))
        .ok_or("a table")?;
    drop(&mut window, table);
    settle(&mut window)?;
    let document = window.state().document.as_ref().ok_or("a scene")?;
    let surface = format!("{:?}", document.materials[0].surface);
    assert!(
        surface.contains("Lobes"),
        "{surface} {:?}",
        window.state().messages
    );
    Ok(())
}

fn reload() -> Outcome {
    let folder = tempfile::tempdir()?;
    let (mesh, scene) = (
        folder.path().join("table.obj"),
        folder.path().join("scene.toml"),
    );
    std::fs::write(&mesh, TABLE)?;
    let material = |red: f32| {
        format!(
            "mesh = \"table.obj\"\n[materials.wood]\nmodel = \"diffuse\"\ndiffuse = [{red}, 0.2, 0.2]\n"
        )
    };
    std::fs::write(&scene, material(0.3))?;
    let mut window = window(&Start {
        files: vec![scene.clone(), start_prepared().files[1].clone()],
        ..start()
    });
    settle(&mut window)?;
    let orbit = window.state().orbit.turned(0.1, 0.0);
    window.state_mut().orbit = orbit;
    let surface = |viewer: &Viewer| {
        let document = viewer.document.as_ref().expect("a scene");
        format!("{:?}", document.materials[0].surface)
    };
    assert!(
        surface(window.state()).contains("0.3"),
        "{}",
        surface(window.state())
    );
    std::fs::write(&scene, material(0.875))?;
    until(&mut window, "the file is read again", |viewer| {
        surface(viewer).contains("0.875")
    })?;
    assert_eq!(window.state().orbit, orbit, "the camera stays");
    // A file that breaks is a message, and the old scene stays.
    std::fs::write(&scene, "mesh = ")?;
    until(&mut window, "a message", |viewer| {
        viewer.messages.iter().any(|message| message.is_error)
    })?;
    assert!(surface(window.state()).contains("0.875"));
    Ok(())
}

fn without_window() -> Outcome {
    let folder = tempfile::tempdir()?;
    let picture = folder.path().join("picture.png");
    let run = |arguments: &[&str]| {
        let mut command = crate::support::binary("viewer");
        command
            .args(["--device", "cpu", "--quality", "draft", "--environment"])
            .arg(&start_prepared().files[1])
            .args(arguments);
        command.output()
    };
    let text = picture.to_string_lossy().into_owned();
    let size = ["--size", "96x64"];
    let output = run(&[&size[..], &["--screenshot", &text, "--background", "none"]].concat())?;
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let found = image::open(&picture)?.into_rgba8();
    assert_eq!((found.width(), found.height()), (96, 64));
    let (opaque, clear) = (
        found.pixels().filter(|pixel| pixel[3] == 255).count(),
        found.pixels().filter(|pixel| pixel[3] == 0).count(),
    );
    assert!(opaque > 500 && clear > 100, "{opaque} {clear}");

    let frames = folder.path().join("frames");
    let text = frames.to_string_lossy().into_owned();
    let all_around = ["--turntable", &text, "--frames", "4", "--turn", "camera"];
    let output = run(&[&size[..], &all_around].concat())?;
    assert!(
        output.status.success(),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let frame = |index: u32| image::open(frames.join(format!("frame-{index:04}.png")));
    let (first, third) = (frame(0)?.into_rgba8(), frame(2)?.into_rgba8());
    assert_ne!(first, third);
    assert!(frame(4).is_err());
    assert!(frames.join("turntable.png").exists());

    let output = run(&["--screenshot", "out.png", "nothing.obj"])?;
    let words = String::from_utf8_lossy(&output.stderr).into_owned();
    assert!(
        !output.status.success() && words.contains("nothing.obj"),
        "{words}"
    );
    Ok(())
}

/// The program itself, on a screen.
fn on_screen(display: &str) -> Outcome {
    let folder = tempfile::tempdir()?;
    let picture = folder.path().join("window.png");
    // A large window, of which few pixels are drawn: that takes most of the time.
    std::fs::create_dir(folder.path().join("relight"))?;
    std::fs::write(
        folder.path().join("relight/viewer.json"),
        "{ \"resolution\": 0.25 }",
    )?;
    let output = crate::support::binary("viewer")
        .args([
            "--device",
            "cpu",
            "--quality",
            "draft",
            "--lobes",
            "8",
            "--size",
            "700x460",
            "--window-picture",
        ])
        .arg(&picture)
        .env("DISPLAY", display)
        .env_remove("WAYLAND_DISPLAY")
        // Settings of whoever runs the tests stay out of it, and theirs stay as they are.
        .env("XDG_CONFIG_HOME", folder.path())
        .output()?;
    assert!(
        output.status.success(),
        "{}",
        crate::support::describe(&output)
    );
    let found = image::open(&picture)?.into_rgba8();
    assert!(
        found.width() == 700 && found.height() == 460,
        "{:?}",
        found.dimensions()
    );
    let colors: std::collections::HashSet<_> = found.pixels().map(|pixel| pixel.0).collect();
    assert!(colors.len() > 1000, "{} colours", colors.len());
    let settings = folder.path().join("relight/viewer.json");
    assert!(
        std::fs::read_to_string(settings)?.contains("integrators"),
        "settings are kept"
    );
    Ok(())
}

/// Keeps the textures of a window, and draws it with egui's own renderer.
struct Painter(Arc<Mutex<Painted>>);

struct Painted {
    gpu: Gpu,
    renderer: egui_wgpu::Renderer,
}

impl TestRenderer for Painter {
    fn handle_delta(&mut self, delta: &mut egui::TexturesDelta) {
        let painted = &mut *self.0.lock().unwrap_or_else(PoisonError::into_inner);
        let Painted { gpu, renderer } = painted;
        for (id, images) in delta.set.drain() {
            for image in images {
                renderer.update_texture(&gpu.device, &gpu.queue, id, &image);
            }
        }
        for id in delta.free.drain() {
            renderer.free_texture(&id);
        }
    }
}

/// The window as software Vulkan paints it, and the scene as it draws it.
fn on_vulkan() -> Outcome {
    let gpu = Gpu::new(&wgpu::Limits::default())?;
    let format = wgpu::TextureFormat::Rgba8Unorm;
    let renderer =
        egui_wgpu::Renderer::new(&gpu.device, format, egui_wgpu::RendererOptions::PREDICTABLE);
    let painted = Arc::new(Mutex::new(Painted { gpu, renderer }));
    // The window's pixels are compared with the picture's, one by one.
    let settings = start().settings.map(|settings| Settings {
        resolution: 1.0,
        ..settings
    });
    let start = Start {
        device: Device::Gpu,
        settings,
        ..start_prepared()
    };
    let lazy = Lazy {
        start,
        viewer: None,
    };
    let mut window: Window = Harness::builder()
        .with_size(PAINTED.map(|side| side as f32))
        .renderer(Painter(painted.clone()))
        .build_ui_state(|ui, lazy: &mut Lazy| lazy.show(ui), lazy);
    settle(&mut window)?;
    let by_gpu = window.state().pictures[0].clone().ok_or("a picture")?;
    assert!(
        !window.state().device_name.starts_with("processor"),
        "{}",
        window.state().device_name
    );

    // The same picture by the twin.
    let mut twin = relight_viewer::engine::Artist::open(Device::Cpu);
    let shot = window.state().shot(Integrator::Polar).ok_or("a shot")?;
    let size = [by_gpu.image.width, by_gpu.image.height];
    let expected = twin.finished(&shot, size, 1)?;
    let apart = relight_viewer::compose::relative_difference(&by_gpu.image, &expected);
    let apart = apart.ok_or("pictures of something")?;
    assert!(apart < 1e-3, "{apart}");

    let painted = &mut *painted.lock().unwrap_or_else(PoisonError::into_inner);
    let found = paint(painted, &window)?;
    if let Some(folder) = std::env::var_os("RELIGHT_VIEWER_PICTURES") {
        let path = Path::new(&folder).join("window.png");
        image::save_buffer(
            path,
            &found,
            PAINTED[0],
            PAINTED[1],
            image::ColorType::Rgba8,
        )?;
    }
    // The viewport holds the composed pixels, and the panels are not empty.
    let area = window.get_by_label("picture of the scene").rect();
    let (size, composed) = window.state().screen().ok_or("pixels")?;
    let mut same = 0u32;
    let mut compared = 0u32;
    for y in (40..size[1] - 40).step_by(7) {
        for x in (0..size[0]).step_by(7) {
            let inner = 4 * (y * size[0] + x) as usize;
            let (column, row) = (area.left() as u32 + x, area.top() as u32 + y);
            let outer = 4 * (row * PAINTED[0] + column) as usize;
            compared += 1;
            let near =
                |channel: usize| found[outer + channel].abs_diff(composed[inner + channel]) <= 12;
            same += u32::from((0..3).all(near));
        }
    }
    assert!(
        f64::from(same) > 0.9 * f64::from(compared),
        "{same} of {compared}"
    );
    let width = PAINTED[0] as usize;
    let side = (area.right() as usize + 10..width).flat_map(|x| (60..350).map(move |y| (x, y)));
    let brightness: Vec<u8> = side.map(|(x, y)| found[4 * (y * width + x)]).collect();
    let (least, most) = (brightness.iter().min(), brightness.iter().max());
    assert!(
        least < Some(&60) && most > Some(&150),
        "text on the side panel"
    );
    Ok(())
}

fn paint(painted: &mut Painted, window: &Window) -> Result<Vec<u8>, libtest_mimic::Failed> {
    let Painted { gpu, renderer } = painted;
    let size = PAINTED;
    let screen = egui_wgpu::ScreenDescriptor {
        size_in_pixels: size,
        pixels_per_point: 1.0,
    };
    let shapes = window.ctx.tessellate(window.output().shapes.clone(), 1.0);
    let target = gpu.target(size);
    let view = target.create_view(&wgpu::TextureViewDescriptor::default());
    let mut encoder = gpu
        .device
        .create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let buffers = renderer.update_buffers(&gpu.device, &gpu.queue, &mut encoder, &shapes, &screen);
    {
        let mut pass = encoder
            .begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("window"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            })
            .forget_lifetime();
        renderer.render(&mut pass, &shapes, &screen);
    }
    gpu.queue
        .submit(buffers.into_iter().chain([encoder.finish()]));
    Ok(gpu.read_texture(&target)?)
}
