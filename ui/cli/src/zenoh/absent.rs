//! A program without Zenoh: it says so.

use trocar::app::App;
use trocar::run::Progress;
use trocar::summary::{Exit, SCHEMA};

use super::wish::Wish;
use crate::args::zenoh::{ZenohArgs, ZenohCommand};
use crate::failure::Failure;
use crate::output;

/// What to do about it.
const ABSENT: &str = "this program was built without Zenoh; a release has it, and so has \
                      'cargo run --release --features zenoh -- …'";

/// A session's node: there is none.
pub struct Beyond;

impl Beyond {
    /// No node, if none is asked for.
    pub fn open(wish: &Wish<'_>) -> Result<Option<Self>, Failure> {
        match wish.text {
            Some(_) => Err(Failure::usage(format!("--zenoh: {ABSENT}"))),
            None => Ok(None),
        }
    }

    /// Nothing to do.
    pub fn serve(&mut self, _progress: &mut Progress<'_>) {}

    /// Nothing went wrong.
    pub fn close(self) -> Result<(), Failure> {
        Ok(())
    }
}

/// No device more.
pub fn with_devices(app: App) -> App {
    app
}

/// `trocar zenoh`.
pub fn command(args: &ZenohArgs) -> Result<Exit, Failure> {
    let json = match &args.command {
        ZenohCommand::List(args) => args.json,
        ZenohCommand::Router(args) => args.json,
        ZenohCommand::Certificate(args) => args.json,
    };
    if json {
        output::print_json(&serde_json::json!({ "schema": SCHEMA, "error": ABSENT }))?;
    }
    Err(Failure::usage(ABSENT))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn without_zenoh_the_program_says_how_to_get_it() {
        let app = App::new();
        let scenario = app.scenario("wall").expect("a scenario");
        let first = scenario.spawn(app.registry()).expect("a scene").snapshot();
        let network = trocar::network::Network::None;
        let mut wish =
            Wish { text: None, scenario: &scenario, first: &first, network: &network, is_silent: true };
        assert!(matches!(Beyond::open(&wish), Ok(None)));
        wish.text = Some("");
        let failure = Beyond::open(&wish).err().expect("refused");
        assert!(
            failure.exit == Exit::Usage && failure.message.contains("--features zenoh"),
            "{}",
            failure.message
        );
    }

    /// Where the program has Zenoh, what stands in for it has the same form.
    #[cfg(feature = "zenoh")]
    #[test]
    fn both_builds_have_the_same_form() {
        use super::super::{commands, present};
        type Command = fn(&ZenohArgs) -> Result<Exit, Failure>;
        type Serve<T> = fn(&mut T, &mut Progress<'_>);
        type Close<T> = fn(T) -> Result<(), Failure>;
        let _: [Command; 2] = [command, commands::command];
        let _: [fn(App) -> App; 2] = [with_devices, present::with_devices];
        let _: fn(&Wish<'_>) -> Result<Option<Beyond>, Failure> = Beyond::open;
        let _: fn(&Wish<'_>) -> Result<Option<present::Beyond>, Failure> = present::Beyond::open;
        let _: (Serve<Beyond>, Close<Beyond>) = (Beyond::serve, Beyond::close);
        let _: (Serve<present::Beyond>, Close<present::Beyond>) =
            (present::Beyond::serve, present::Beyond::close);
    }
}
