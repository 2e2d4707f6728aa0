//! `trocar new`: writes a project from a template.

use std::path::{Path, PathBuf};

use trocar::summary::Exit;
use trocar::templates::{Source, TEMPLATES, TemplateError, checkout, template};

use crate::args::NewArgs;
use crate::failure::{Failure, did_you_mean};
use crate::output;

/// Writes the project.
pub fn new(args: &NewArgs) -> Result<Exit, Failure> {
    let known = template(&args.template).map_err(|error| {
        let hint = did_you_mean(&args.template, TEMPLATES.iter().map(|template| template.name));
        Failure::usage(format!("{error}{hint}"))
    })?;
    let folder = args.path.clone().unwrap_or_else(|| PathBuf::from(&args.name));
    let files = known.write(&args.name, &folder, &source(args)?).map_err(|error| match error {
        TemplateError::Name { .. } | TemplateError::Path(_) => Failure::usage(error),
        error => Failure::invalid(error),
    })?;
    let mut lines = vec![format!("{}: {}", folder.display(), known.about)];
    lines.extend(
        files.iter().map(|file| format!("  {}", file.strip_prefix(&folder).unwrap_or(file).display())),
    );
    lines.push("next:".to_owned());
    lines.push(format!("  cd {}", folder.display()));
    lines.push("  cargo test --release".to_owned());
    let scenario = if folder.join("scenario.toml").is_file() { "scenario.toml" } else { "peg-transfer" };
    lines.push(format!("  cargo run --release -- run {scenario} --seconds 10"));
    output::print_text(&lines.join("\n"))?;
    Ok(Exit::Ok)
}

/// The source of Trocar for the project: the requested one, or the checkout that this program was built from.
fn source(args: &NewArgs) -> Result<Source, Failure> {
    match &args.trocar {
        Some(text) if text.contains("://") || text.starts_with("git@") => Ok(Source::Git(text.clone())),
        Some(text) => Ok(Source::Checkout(Path::new(text).to_owned())),
        None => checkout().map(Source::Checkout).ok_or_else(|| {
            Failure::usage(
                "the checkout that this program was built from is gone; name one, or the URL of a repository: \
                 --trocar PLACE",
            )
        }),
    }
}
