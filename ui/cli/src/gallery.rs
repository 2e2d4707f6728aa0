//! `trocar gallery`: a picture of every scenario, and a page with all of them.

use std::path::PathBuf;

use clap::{Args, ValueHint};
use indicatif::{ProgressBar, ProgressStyle};
use serde_json::json;
use trocar::app::{App, SCENARIOS};
use trocar::run::{RunOptions, run};
use trocar::summary::{Exit, SCHEMA};
use trocar_scene::output_file;
use trocar_scene::scenario::Scenario;
use trocar_viewer::{Layout, OffscreenRenderer, Quality, View};

use crate::args::picture::size;
use crate::args::values::positive;
use crate::escape::{self, printable};
use crate::failure::Failure;
use crate::output::{self, file_stem, replace};

/// `trocar gallery`.
#[derive(Debug, Args)]
pub struct GalleryArgs {
    /// Where the pictures go, with a page that shows them all
    #[arg(default_value = "gallery", value_hint = ValueHint::DirPath)]
    pub folder: PathBuf,
    /// Names of scenarios, or TOML files [default: all that come with the program]
    #[arg(long = "scenario", value_name = "SCENARIO", value_hint = ValueHint::FilePath)]
    pub scenarios: Vec<String>,
    /// The moment that is shown: time of the session, in seconds
    #[arg(long, allow_negative_numbers = true, default_value_t = 8.0, value_parser = positive)]
    pub at: f64,
    /// Seed of everything random
    #[arg(long, default_value_t = 1, allow_negative_numbers = true)]
    pub seed: u64,
    /// Width and height in pixels
    #[arg(long, value_name = "WxH", default_value = "800x600", value_parser = size)]
    pub size: (u32, u32),
    /// Overwrite pictures and page of the folder when they are there
    #[arg(long)]
    pub force: bool,
    /// Print exactly one JSON object on stdout
    #[arg(long)]
    pub json: bool,
}

/// The row of one picture.
struct Shot {
    scenario: String,
    title: String,
    about: String,
    file: String,
}

/// Makes the requested pictures.
pub fn gallery(app: &App, args: &GalleryArgs) -> Result<Exit, Failure> {
    let made = attempt(app, args);
    if let (true, Err(failure)) = (args.json, &made) {
        output::print_json(&json!({ "schema": SCHEMA, "error": failure.message }))?;
    }
    made
}

fn attempt(app: &App, args: &GalleryArgs) -> Result<Exit, Failure> {
    let replace = replace(args.force);
    let names: Vec<String> = match args.scenarios.is_empty() {
        true => SCENARIOS.iter().map(|(name, _)| (*name).to_owned()).collect(),
        false => args.scenarios.clone(),
    };
    let scenarios: Vec<Scenario> =
        names.iter().map(|name| Ok(app.scenario(name)?)).collect::<Result<_, Failure>>()?;
    OffscreenRenderer::new(None)?.check_size([args.size.0, args.size.1])?;
    std::fs::create_dir_all(&args.folder)
        .map_err(|error| Failure::invalid(format!("{}: {error}", args.folder.display())))?;
    let page = args.folder.join("index.html");
    // Before minutes of drawing.
    output_file::check(&page, replace)?;
    for scenario in &scenarios {
        output_file::check(&args.folder.join(file_of(scenario)), replace)?;
    }
    let bar = ProgressBar::new(names.len() as u64);
    let style = ProgressStyle::with_template("{bar:30} {pos} of {len} scenarios  {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    let mut shots = Vec::new();
    for scenario in &scenarios {
        bar.set_message(printable(&scenario.name));
        shots.push(shoot(app, args, scenario)?);
        bar.inc(1);
    }
    bar.finish_and_clear();
    output_file::write(&page, html(&shots).as_bytes(), replace)?;
    if args.json {
        let rows: Vec<_> = shots
            .iter()
            .map(|shot| json!({ "scenario": shot.scenario, "title": shot.title, "picture": args.folder.join(&shot.file) }))
            .collect();
        output::print_json(&json!({ "schema": SCHEMA, "pictures": rows, "page": page, "error": null }))?;
    } else {
        let lines: Vec<String> = shots
            .iter()
            .map(|shot| format!("{}  {}", args.folder.join(&shot.file).display(), shot.title))
            .collect();
        output::print_text(&format!("{}\n{}", lines.join("\n"), page.display()))?;
    }
    Ok(Exit::Ok)
}

/// The picture's name in the folder.
fn file_of(scenario: &Scenario) -> String {
    format!("{}.png", file_stem(scenario))
}

/// Runs a scenario in virtual time up to the requested moment, and takes the picture.
fn shoot(app: &App, args: &GalleryArgs, scenario: &Scenario) -> Result<Shot, Failure> {
    let options =
        RunOptions { lockstep: true, seconds: Some(args.at), seed: args.seed, ..RunOptions::default() };
    let outcome = run(app, scenario, &options, &mut |_| {})?;
    let scene = &outcome.kernel.snapshot;
    let mut renderer = OffscreenRenderer::new(Some(scenario.folder().to_owned()))?;
    renderer.quality = Quality::FINE;
    let (width, height) = args.size;
    let view = View::default_of(scene, Some(f64::from(width) / f64::from(height)));
    let picture = renderer.picture(scene, &view, &Layout::Mono, [width, height])?;
    let file = file_of(scenario);
    output_file::write(&args.folder.join(&file), &picture.png()?, replace(args.force))?;
    let title = if scenario.title.is_empty() { scenario.name.clone() } else { scenario.title.clone() };
    Ok(Shot { scenario: scenario.name.clone(), title, about: scenario.description.clone(), file })
}

fn html(shots: &[Shot]) -> String {
    let mut page = String::from(
        "<!doctype html><html lang=\"en\"><meta charset=\"utf-8\"><title>Scenarios</title>\
         <meta name=\"viewport\" content=\"width=device-width\">\n\
         <style>body{font:16px/1.5 system-ui,sans-serif;max-width:60rem;margin:2rem auto;padding:0 1rem;\
         background:#15171a;color:#dde}figure{margin:0 0 2.5rem}img{width:100%;border-radius:8px}\
         code{color:#9cf}</style>\n<h1>Scenarios</h1>\n",
    );
    for shot in shots {
        let text = |text: &str| escape::escape(text);
        page.push_str(&format!(
            "<figure><img src=\"{}\" alt=\"{}\"><figcaption><strong>{}</strong> <code>trocar run {}</code><br>{}</figcaption></figure>\n",
            text(&shot.file),
            text(&shot.title),
            text(&shot.title),
            text(&shot.scenario),
            text(&shot.about),
        ));
    }
    page
}
