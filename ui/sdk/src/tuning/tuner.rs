//! Changes fields of a running scene, and switches between sets of values.

use std::collections::BTreeMap;

use serde_json::Value;
use thiserror::Error;
use trocar_kernel::OperatorError;
use trocar_scene::{Commands, ComponentError, Snapshot, with_entity_names};

use super::field::{self, Field, FieldError};
use super::sets::{BASE, SetsError, TuningSet, TuningSets, VALUES_MAX};
use crate::session::Session;

/// Why a value cannot be set.
#[derive(Debug, Error)]
pub enum TuneError {
    /// The field is invalid.
    #[error(transparent)]
    Field(#[from] FieldError),
    /// The set is invalid.
    #[error(transparent)]
    Sets(#[from] SetsError),
    /// The component refuses the value.
    #[error("'{field}': {source}")]
    Refused {
        /// The field, or the component if several of its fields are set.
        field: String,
        /// Why.
        source: ComponentError,
    },
    /// The session refused it.
    #[error(transparent)]
    Session(#[from] OperatorError),
    /// Too many fields are tuned.
    #[error("at most {VALUES_MAX} fields can be tuned")]
    TooMany,
}

/// The change of one field.
#[derive(Clone, Debug, PartialEq)]
pub struct Tuned {
    /// The field.
    pub field: Field,
    /// Its value before.
    pub before: Value,
    /// Its value afterwards.
    pub after: Value,
}

/// Fields to be changed together: made by a [`Tuner`], written by any writer of the scene.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Change {
    /// The fields, in order.
    pub fields: Vec<Tuned>,
    /// The set in use afterwards.
    set: Option<String>,
    /// Whole components.
    rows: BTreeMap<Field, Value>,
}

impl Change {
    /// Writes the changed components. Only the tuned fields change. A controller that writes the component in every
    /// tick overwrites them.
    ///
    /// # Errors
    /// When a component refuses its value; the commands must then not be applied.
    pub fn write(&self, scene: &Snapshot, out: &mut Commands) -> Result<(), TuneError> {
        with_entity_names(field::names(scene), || {
            for (at, row) in &self.rows {
                let refused = |source| TuneError::Refused { field: self.called(at), source };
                let id = scene
                    .registry()
                    .by_name(at.component)
                    .map_err(|error| refused(ComponentError::Malformed(error.to_string())))?;
                scene.registry().put_json(id, out, at.entity, row).map_err(refused)?;
            }
            Ok(())
        })
    }

    /// Whether there is nothing to change.
    pub fn is_empty(&self) -> bool {
        self.rows.is_empty()
    }

    /// The name of a component in messages: that of its tuned field, if there is only one.
    fn called(&self, row: &Field) -> String {
        let mut tuned = self
            .fields
            .iter()
            .filter(|tuned| tuned.field.entity == row.entity && tuned.field.component == row.component);
        match (tuned.next(), tuned.next()) {
            (Some(only), None) => only.field.to_string(),
            _ => row.to_string(),
        }
    }
}

/// Tracks the tuned fields, their original values, and the sets to choose from.
///
/// A [`Change`] is made from a snapshot and [applied](Tuner::apply) to the session. Without a [`Session`], write it to
/// commands and [accept](Tuner::accept) it once the Model has applied them.
#[derive(Clone, Debug, Default)]
pub struct Tuner {
    /// The original value of every tuned field.
    base: BTreeMap<Field, Value>,
    /// Values set before the session that are outside components: gravity, rates, parameters.
    keys: Vec<(String, Value)>,
    sets: TuningSets,
    in_use: Option<String>,
}

impl Tuner {
    /// A tuner with these sets to choose from.
    pub fn new(sets: TuningSets) -> Self {
        Self { sets, ..Self::default() }
    }

    /// Records values that [`tuned_scenario`](super::tuned_scenario) set before the session began: `scene` is the
    /// scenario's scene without them, and `set` the name of their set.
    ///
    /// # Errors
    /// When there are too many.
    pub fn began_with(
        &mut self,
        scene: &Snapshot,
        values: &[(String, Value)],
        set: Option<&str>,
    ) -> Result<(), TuneError> {
        for (name, value) in values {
            // A name that is no field is a key outside components; otherwise the session would not have started.
            let Ok(fields) = field::find(scene, name) else {
                self.keys.retain(|(known, _)| known != name);
                self.keys.push((name.clone(), value.clone()));
                continue;
            };
            for field in fields {
                let before = field::read(scene, &field)?;
                self.base.entry(field).or_insert(before);
            }
        }
        if self.base.len() + self.keys.len() > VALUES_MAX {
            return Err(TuneError::TooMany);
        }
        self.in_use = set.map(str::to_owned);
        Ok(())
    }

    /// The sets.
    pub fn sets(&self) -> &TuningSets {
        &self.sets
    }

    /// The set in use: [`BASE`], a set's name, or `None` after single fields were tuned.
    pub fn in_use(&self) -> Option<&str> {
        if self.base.is_empty() { Some(BASE) } else { self.in_use.as_deref() }
    }

    /// Sets single fields.
    ///
    /// # Errors
    /// [`TuneError`] names the field and the valid values.
    pub fn set<'a>(
        &self,
        scene: &Snapshot,
        values: impl IntoIterator<Item = (&'a str, &'a Value)>,
    ) -> Result<Change, TuneError> {
        self.change(scene, resolve(scene, values)?, None)
    }

    /// Switches to a set of values: sets its fields, and restores other tuned fields to their original values. [`BASE`]
    /// is the empty set.
    ///
    /// # Errors
    /// [`TuneError`] when there is no such set, or a field of it does not fit the scene.
    pub fn switch(&self, scene: &Snapshot, name: &str) -> Result<Change, TuneError> {
        let mut wanted = self.base.clone();
        // Fields that are gone from the scene cannot be restored.
        wanted.retain(|field, _| field::read(scene, field).is_ok());
        if name != BASE {
            let set = self.sets.get(name)?;
            wanted.extend(resolve(scene, set.iter().map(|(text, value)| (text.as_str(), value)))?);
        }
        self.change(scene, wanted, Some(name.to_owned()))
    }

    /// Stores the tuned values as a set, replacing an earlier one of that name.
    ///
    /// # Errors
    /// When the name is invalid or there is no room.
    pub fn keep(&mut self, scene: &Snapshot, name: &str) -> Result<&TuningSet, TuneError> {
        let set =
            self.changed(scene).into_iter().map(|tuned| (tuned.field.to_string(), tuned.after)).collect();
        self.sets.keep(name, set)?;
        self.in_use = Some(name.to_owned());
        Ok(self.sets.get(name)?)
    }

    /// Fields whose values differ from the original ones.
    pub fn changed(&self, scene: &Snapshot) -> Vec<Tuned> {
        let now = |field: &Field| field::read(scene, field).ok();
        self.base
            .iter()
            .filter_map(|(field, before)| Some((field, before, now(field)?)))
            .filter(|(_, before, after)| *before != after)
            .map(|(field, before, after)| Tuned { field: field.clone(), before: before.clone(), after })
            .collect()
    }

    /// The values for [`save`](super::save): everything that differs from the scenario, by name.
    pub fn values(&self, scene: &Snapshot) -> Vec<(String, Value)> {
        let changed = self.changed(scene).into_iter().map(|tuned| (tuned.field.to_string(), tuned.after));
        self.keys.iter().cloned().chain(changed).collect()
    }

    /// Writes a change into a running session and returns the changed fields.
    ///
    /// # Errors
    /// When a component refuses its value, or the Model does not answer; nothing has changed then.
    pub fn apply(&mut self, session: &mut Session, change: Change) -> Result<Vec<Tuned>, TuneError> {
        let mut refused = None;
        if !change.is_empty() {
            let scene = session.snapshot();
            let applied = session.apply(|out| {
                if let Err(error) = change.write(&scene, out) {
                    // Commands queued before it must not be applied without it.
                    out.clear();
                    refused = Some(error);
                }
            });
            refused.map_or(Ok(()), Err)?;
            applied?;
        }
        let tuned = change.fields.iter().filter(|tuned| tuned.before != tuned.after).cloned().collect();
        self.accept(change);
        Ok(tuned)
    }

    /// Records a change that the Model has applied.
    pub fn accept(&mut self, change: Change) {
        for tuned in change.fields {
            self.base.entry(tuned.field).or_insert(tuned.before);
        }
        self.in_use = change.set;
    }

    fn change(
        &self,
        scene: &Snapshot,
        wanted: BTreeMap<Field, Value>,
        set: Option<String>,
    ) -> Result<Change, TuneError> {
        let known = wanted.keys().filter(|field| self.base.contains_key(*field)).count();
        if self.base.len() + wanted.len() - known > VALUES_MAX {
            return Err(TuneError::TooMany);
        }
        let mut change = Change { set, ..Change::default() };
        for (field, value) in wanted {
            let at = Field { path: Vec::new(), ..field.clone() };
            let row = match change.rows.remove(&at) {
                Some(row) => row,
                None => field::row(scene, &field)?,
            };
            let mut row = row;
            let before = field::write(&field, &mut row, &value)?;
            let after = field::read_row(&field, &row)?;
            change.rows.insert(at, row);
            change.fields.push(Tuned { field, before, after });
        }
        // A component that does not change is not written.
        let fields = &change.fields;
        change.rows.retain(|row, _| {
            fields.iter().any(|tuned| {
                (tuned.field.entity, tuned.field.component) == (row.entity, row.component)
                    && tuned.before != tuned.after
            })
        });
        Ok(change)
    }
}

/// Resolves names to fields of the scene; if two names mean the same field, the one with fewer stars wins, and of
/// equals the later one.
pub(super) fn resolve<'a>(
    scene: &Snapshot,
    values: impl IntoIterator<Item = (&'a str, &'a Value)>,
) -> Result<BTreeMap<Field, Value>, TuneError> {
    let mut values: Vec<(&str, &Value)> = values.into_iter().collect();
    values.sort_by_key(|(text, _)| std::cmp::Reverse(text.matches('*').count()));
    let mut wanted = BTreeMap::new();
    for (text, value) in values {
        for field in field::find(scene, text)? {
            wanted.insert(field, value.clone());
        }
        if wanted.len() > VALUES_MAX {
            return Err(TuneError::TooMany);
        }
    }
    Ok(wanted)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::App;
    use trocar_scene::{EntityAllocator, RigidBody, SimTime, Store};

    /// A scene with a tuner that may write to it.
    struct Bench(Store, Tuner);

    impl Bench {
        fn new(sets: &str) -> Self {
            let app = App::new();
            let store = app.scenario("peg-transfer").unwrap().spawn(app.registry()).unwrap();
            Self(store, Tuner::new(TuningSets::parse(sets, "sets.toml").unwrap()))
        }
        fn apply(&mut self, change: Result<Change, TuneError>) -> Result<(), TuneError> {
            let change = change?;
            let scene = self.0.snapshot();
            let mut commands = Commands::new(scene.registry().clone(), EntityAllocator::new(0, 65_534));
            change.write(&scene, &mut commands)?;
            commands.seal();
            self.0.apply(&mut commands, SimTime::ZERO);
            self.1.accept(change);
            Ok(())
        }
        fn set(&mut self, text: &str) -> Result<(), TuneError> {
            let (field, value) = field::parse_assignment(text).unwrap();
            let change = self.1.set(&self.0.snapshot(), [(field.as_str(), &value)]);
            self.apply(change)
        }
        fn switch(&mut self, name: &str) -> Result<(), TuneError> {
            let change = self.1.switch(&self.0.snapshot(), name);
            self.apply(change)
        }
        fn body(&self, name: &str) -> RigidBody {
            let scene = self.0.snapshot();
            scene.get::<RigidBody>(scene.find(name).unwrap()).unwrap().clone()
        }
    }

    const SETS: &str = "schema = 1\n[sets.a]\n\"ring.*.rigid_body.mass\" = 0.01\n\"ring.2.rigid_body.mass\" = 0.03\n\
                        [sets.b]\n\"ring.1.rigid_body.friction\" = 0.25\n";

    #[test]
    fn going_from_set_to_set_leaves_nothing_of_the_last_one() {
        let mut bench = Bench::new(SETS);
        let before = bench.body("ring.1");
        assert_eq!(bench.1.in_use(), Some(BASE));
        bench.switch("a").unwrap();
        assert_eq!((bench.body("ring.1").mass, bench.body("ring.2").mass), (0.01, 0.03));
        bench.switch("b").unwrap();
        assert_eq!(bench.body("ring.1"), RigidBody { friction: 0.25, ..before.clone() });
        assert_eq!(bench.body("ring.2").mass, before.mass);
        assert_eq!(bench.1.in_use(), Some("b"));
        bench.switch(BASE).unwrap();
        assert_eq!(bench.body("ring.1"), before);
        assert!(bench.1.changed(&bench.0.snapshot()).is_empty());
    }

    #[test]
    fn what_was_tuned_by_hand_can_be_kept_as_a_set() {
        let mut bench = Bench::new(SETS);
        bench.set("ring.3.rigid_body.mass=0.5").unwrap();
        bench.set("ring.3.rigid_body.friction=0.1").unwrap();
        bench.set("ring.3.rigid_body.mass=0.25").unwrap();
        assert_eq!(bench.1.in_use(), None);
        let scene = bench.0.snapshot();
        assert_eq!(bench.1.keep(&scene, "c").unwrap().len(), 2);
        bench.switch(BASE).unwrap();
        assert_eq!(bench.body("ring.3"), bench.body("ring.1"));
        bench.switch("c").unwrap();
        assert_eq!((bench.body("ring.3").mass, bench.body("ring.3").friction), (0.25, 0.1));
    }

    #[test]
    fn what_was_set_before_the_session_can_be_left_and_saved_too() {
        let app = App::new();
        let scenario = app.scenario("peg-transfer").unwrap();
        let untuned = scenario.spawn(app.registry()).unwrap().snapshot();
        let values =
            [("gravity.2".to_owned(), (-1.0).into()), ("ring.1.rigid_body.mass".to_owned(), 0.5.into())];
        let tuned = crate::tuning::tuned_scenario(&app, &scenario, &values).unwrap();
        let mut bench = Bench::new(SETS);
        bench.0 = tuned.spawn(app.registry()).unwrap();
        bench.1.began_with(&untuned, &values, None).unwrap();
        assert_eq!(bench.1.values(&bench.0.snapshot()), values);
        bench.switch(BASE).unwrap();
        assert_eq!(bench.body("ring.1"), bench.body("ring.2"));
        assert_eq!(bench.1.values(&bench.0.snapshot()), values[..1]);
    }

    #[test]
    fn a_refused_value_changes_nothing() {
        let mut bench = Bench::new(SETS);
        let before = bench.0.snapshot().revision();
        let error = bench.set("ring.1.rigid_body.mass=-1").unwrap_err().to_string();
        assert!(error.starts_with("'ring.1.rigid_body.mass': mass: -1 is out of range"), "{error}");
        let error = bench.set("ring.1.pose.rotation.0=0.5").unwrap_err().to_string();
        assert!(error.contains("not normalised"), "{error}");
        assert!(bench.set("ring.1.rigid_body.motion=flying").is_err());
        assert!(bench.switch("d").unwrap_err().to_string().contains("base, a, b"));
        assert_eq!(bench.0.snapshot().revision(), before);
        assert_eq!(bench.1.in_use(), Some(BASE));
    }

    #[test]
    fn a_session_in_virtual_time_is_tuned_between_its_steps() {
        let app = App::new();
        let options = crate::run::RunOptions { lockstep: true, ..Default::default() };
        let mut session = crate::run::start(&app, &app.scenario("peg-transfer").unwrap(), &options).unwrap();
        session.run_until(SimTime::from_millis(50));
        let mut tuner = Tuner::new(TuningSets::parse(SETS, "sets.toml").unwrap());
        let change = tuner.switch(&session.snapshot(), "a").unwrap();
        assert_eq!(tuner.apply(&mut session, change).unwrap().len(), 6);
        session.run_until(SimTime::from_millis(100));
        let scene = session.snapshot();
        assert_eq!(scene.get::<RigidBody>(scene.find("ring.2").unwrap()).unwrap().mass, 0.03);
        let revision = scene.revision();
        let negative = Value::from(-1.0);
        let change = tuner.set(&scene, [("ring.1.rigid_body.mass", &negative)]).unwrap();
        assert!(tuner.apply(&mut session, change).unwrap_err().to_string().contains("out of range"));
        assert_eq!((session.snapshot().revision(), tuner.in_use()), (revision, Some("a")));
    }

    #[test]
    fn entities_are_written_by_name() {
        let mut bench = Bench::new(SETS);
        bench.set("grasper.left.instrument.port=port.right").unwrap();
        let scene = bench.0.snapshot();
        let tool = scene.get::<trocar_scene::Instrument>(scene.find("grasper.left").unwrap()).unwrap();
        assert_eq!(tool.port, scene.find("port.right"));
        let port = Value::from("port.right");
        assert_eq!(bench.1.values(&scene), [("grasper.left.instrument.port".to_owned(), port)]);
    }
}
