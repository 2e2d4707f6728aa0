//! `#[derive(Component)]`: every key, on types with and without parameters, and what it leaves as it is.

use nalgebra::Point3;
use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use trocar_scene::component::schema_of;
use trocar_scene::{Component, ComponentError, EntityMesh, RecordPolicy, SoftAbilities};

#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = "plain")]
struct Plain(f64);

#[derive(Clone, Debug, Serialize, Deserialize, JsonSchema, Component)]
#[component(name = "full", check = Self::ranges, listed = listed, schema)]
#[component(record = RecordPolicy::Derived, partners = Self::others)]
#[component(soft_body = SoftAbilities { couples: true, ..SoftAbilities::NONE }, crate = trocar_scene)]
#[component(fits = Self::fits, lays = Self::corners)]
struct Full {
    share: f64,
    with: Vec<String>,
}

impl Full {
    fn ranges(&self) -> Result<(), ComponentError> {
        ComponentError::range("share", self.share, 0.0..=1.0, "0 to 1")
    }

    fn fits(&self, mesh: &EntityMesh<'_>) -> Result<(), ComponentError> {
        ComponentError::range(
            "with",
            self.with.len() as f64,
            0.0..=mesh.vertices.len() as f64,
            "at most one each",
        )
    }

    fn corners(&self) -> Option<Vec<Point3<f64>>> {
        (self.share > 0.0).then(|| vec![Point3::origin(); 2])
    }

    fn others(&self) -> Vec<&str> {
        self.with.iter().map(String::as_str).collect()
    }
}

fn listed(full: &Full) -> u64 {
    full.with.len() as u64
}

const NAMES: [&str; 2] = ["first", "second"];

#[derive(Clone, Debug, Serialize, Deserialize, Component)]
#[component(name = NAMES[N])]
enum Numbered<const N: usize> {
    On,
    Off,
}

#[test]
fn a_derived_component_has_what_its_attribute_says() {
    let full = Full { share: 0.5, with: vec!["liver".to_owned()] };
    assert_eq!((Full::NAME, Full::RECORD), ("full", RecordPolicy::Derived));
    assert_eq!(Full::SOFT_BODY, Some(SoftAbilities { couples: true, ..SoftAbilities::NONE }));
    assert_eq!(Full::PARTNERS.expect("declared")(&full), ["liver"]);
    assert_eq!(full.listed(), Some(1));
    let corners = Full::LAYS.expect("declared")(&full).expect("two corners");
    let fits =
        |vertices| Full::FITS.expect("declared")(&full, &EntityMesh { vertices, ..EntityMesh::default() });
    assert!(fits(&corners).is_ok() && fits(&[]).is_err());
    assert_eq!(Full::schema(), Some(schema_of::<Full>()));
    assert_eq!(full.check(), Ok(()));
    let error = Full { share: 2.0, ..full.clone() }.check().expect_err("too large").to_string();
    assert_eq!(error, "share: 2 is out of range (0 to 1)");
    assert_eq!(Full { share: f64::NAN, ..full }.check(), Err(ComponentError::NotFinite { index: 0 }));
}

#[test]
fn what_the_attribute_does_not_say_stays_as_the_trait_has_it() {
    assert_eq!((Plain::NAME, Plain::RECORD), ("plain", RecordPolicy::Exact));
    assert!(Plain::SOFT_BODY.is_none() && Plain::PARTNERS.is_none() && Plain::schema().is_none());
    assert!(Plain::FITS.is_none() && Plain::LAYS.is_none());
    assert_eq!((Plain(1.0).check(), Plain(1.0).listed()), (Ok(()), None));
    assert_eq!(Plain(f64::INFINITY).check(), Err(ComponentError::NotFinite { index: 0 }));
    assert_eq!((Numbered::<0>::NAME, Numbered::<1>::NAME), ("first", "second"));
    assert!(Numbered::<0>::On.check().and(Numbered::<1>::Off.check()).is_ok());
}
