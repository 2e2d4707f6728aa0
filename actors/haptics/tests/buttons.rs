//! Buttons and grippers through the controller, with a device that is scripted.

use crate::support as bench;
use trocar_devices::{
    Capabilities, DeviceError, DeviceFaults, DeviceState, Dofs, DriverConfig, DriverCore, HapticDevice,
    Workspace, Wrench, link,
};
use trocar_haptics::{HapticsConfig, HapticsController};
use trocar_scene::{
    BuildContext, Commands, Controller, Entity, EntityAllocator, Events, Jobs, SimTime, Store, Tick,
};

/// Presses button 3 from 10 to 15 ms and button 0 from 12 ms on.
struct Scripted {
    capabilities: Capabilities,
}

impl HapticDevice for Scripted {
    fn capabilities(&self) -> &Capabilities {
        &self.capabilities
    }
    fn open(&mut self, _now_ns: u64) -> Result<(), DeviceError> {
        Ok(())
    }
    fn read(&mut self, now_ns: u64) -> Result<DeviceState, DeviceError> {
        let millis = now_ns / 1_000_000;
        let third = u32::from((10..15).contains(&millis)) << 3;
        let first = u32::from(millis >= 12);
        Ok(DeviceState { buttons: third | first, connected: true, gripper: 9.0, ..DeviceState::unknown() })
    }
    fn write(&mut self, _now_ns: u64, _wrench: &Wrench) -> Result<(), DeviceError> {
        Ok(())
    }
    fn close(&mut self) {}
}

#[test]
fn a_press_of_five_milliseconds_is_an_event_with_its_edges() {
    let bench = bench::Bench::new(
        trocar_devices::VirtualHandConfig::default(),
        HapticsConfig::default(),
        bench::Mount::Free,
        bench::Wall::plane(nalgebra::Vector3::zeros(), nalgebra::Vector3::x(), 500),
    );
    let mut store = Store::from_snapshot(&bench.store.snapshot());
    let capabilities = Capabilities {
        name: "scripted".into(),
        workspace: Workspace::centred(nalgebra::Vector3::repeat(0.1)),
        max_force_newtons: 3.3,
        max_torque: 0.0,
        max_stiffness: 1000.0,
        input_dofs: Dofs::Six,
        output_dofs: Dofs::Three,
        apparent_mass: 0.05,
    };
    let mut device = Scripted { capabilities: capabilities.clone() };
    let (end, slot, _) = link();
    let mut driver = DriverCore::new(DriverConfig::default(), &device, end, DeviceFaults::new());
    let snapshot = store.snapshot();
    let me = Entity::of_writer(0, 2);
    let context = BuildContext {
        scene: &snapshot,
        time: SimTime::ZERO,
        period: SimTime::from_millis(1),
        name: "haptics.left",
        me,
        epoch: 1,
        seed: 1,
    };
    let mut controller = HapticsController::new(
        &context,
        bench::HAND,
        slot.take(1).unwrap(),
        capabilities,
        HapticsConfig::default(),
    )
    .unwrap();
    let mut out = Commands::new(store.view().registry().clone(), EntityAllocator::new(0, 2));
    for number in 0..30u64 {
        let time = SimTime::from_millis(number);
        driver.step(time.as_nanos(), &mut device);
        let snapshot = store.snapshot();
        let tick = Tick {
            time,
            period: SimTime::from_millis(1),
            number,
            me,
            epoch: 1,
            events: Events::new(snapshot.events(), snapshot.events().next()),
            jobs: &Jobs::default(),
        };
        out.begin(time);
        controller.tick(&tick, &snapshot, &mut out).unwrap();
        out.seal();
        store.apply(&mut out, time);
        out.clear();
    }
    let events: Vec<_> = store
        .view()
        .events()
        .since(0)
        .map(|(_, event)| (event.name.to_string(), event.value, event.at.as_nanos() / 1_000_000))
        .collect();
    assert_eq!(
        events,
        [
            ("button_pressed".to_owned(), 3.0, 10),
            ("button_pressed".to_owned(), 0.0, 12),
            ("button_released".to_owned(), 3.0, 15),
        ]
    );
    // A gripper beyond the instrument's jaws opens them to their limit, not further.
    let target = store.view().get::<trocar_scene::InstrumentTarget>(bench::INSTRUMENT).unwrap();
    assert_eq!(target.jaw_angle, trocar_scene::Instrument::default().jaw_angle_max);
}
