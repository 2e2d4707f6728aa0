//! Parses the names after `--show`.

use std::ffi::OsStr;

use clap::builder::{NonEmptyStringValueParser, PossibleValue, TypedValueParser};
use clap::error::ErrorKind;
use trocar_viewer::{Overlay, Overlays};

/// The parser of `--show`.
#[derive(Clone, Copy)]
pub struct Show;

impl TypedValueParser for Show {
    type Value = String;

    fn parse_ref(
        &self,
        command: &clap::Command,
        argument: Option<&clap::Arg>,
        value: &OsStr,
    ) -> Result<String, clap::Error> {
        let word = NonEmptyStringValueParser::new().parse_ref(command, argument, value)?;
        match Overlays::parse(&word) {
            Ok(_) => Ok(word),
            Err(error) => {
                Err(clap::Error::raw(ErrorKind::ValueValidation, format!("{error}\n")).with_cmd(command))
            }
        }
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        let value = |overlay: Overlay| PossibleValue::new(overlay.name()).help(overlay.description());
        Some(Box::new(Overlay::ALL.into_iter().map(value)))
    }
}

#[cfg(test)]
mod tests {
    use clap::{CommandFactory, Parser};

    use crate::args::{Cli, Command};

    #[test]
    fn what_is_shown_is_a_list_of_names() {
        let parse = |list: &str| {
            let words = ["trocar", "run", "peg-transfer", "--show", list];
            match Cli::try_parse_from(words).map(|cli| cli.command) {
                Ok(Command::Run(run)) => Ok(run.pictures.show),
                Ok(_) => Err("another command".to_owned()),
                Err(error) => Err(error.to_string()),
            }
        };
        assert_eq!(parse("contacts,field=stress"), Ok(vec!["contacts".into(), "field=stress".into()]));
        let refused = parse("contacts,temprature").expect_err("refused");
        assert!(refused.contains("'temprature' cannot be shown; did you mean 'temperature'?"), "{refused}");
        assert!(refused.contains("wireframe"), "{refused}");
        let mut help = Cli::command();
        let run = help.find_subcommand_mut("run").expect("a command").render_long_help().to_string();
        assert!(run.contains("hand-forces") && run.contains("where the tips of the instruments"), "{run}");
    }
}
