//! The guide: how to build a simulator on Trocar, one chapter at a time.
//!
//! | chapter | answers |
//! |---|---|
//! | [`concepts`] | What are the Model, controllers, snapshots and commands, and why does nothing block? |
//! | [`first_behaviour`] | How do I write a behaviour of my own? |
//! | [`components`] | How do I put data of my own into the scene? |
//! | [`scenarios`] | How do I describe a scene and its controllers? |
//! | [`devices`] | How do I connect a haptic device? |
//! | [`actors`] | How do I connect a part that works by messages: a console, a service, another program? |
//! | [`engines`] | How do I drive a physics engine that is not written in Rust? |
//! | [`supervision`] | What happens when something fails, and how do I test it? |
//! | [`sessions`] | How do I run sessions from a program rather than from the command line? |
//! | [`recording`] | How do I record, replay and evaluate? |
//! | [`testing`] | How do I write deterministic tests? |
//! | [`performance`] | What may a tick do that runs a thousand times a second? |
//!
//! The tests compile all code in the chapters and run nearly all of it.
//! [`templates`](crate::templates) are whole projects to start from: `trocar new my-sim --template controller`.

pub mod concepts {
    #![doc = include_str!("guide/concepts.md")]
}
pub mod first_behaviour {
    #![doc = include_str!("guide/first_behaviour.md")]
}
pub mod components {
    #![doc = include_str!("guide/components.md")]
}
pub mod scenarios {
    #![doc = include_str!("guide/scenarios.md")]
}
pub mod devices {
    #![doc = include_str!("guide/devices.md")]
}
pub mod actors {
    #![doc = include_str!("guide/actors.md")]
}
pub mod engines {
    #![doc = include_str!("guide/engines.md")]
}
pub mod supervision {
    #![doc = include_str!("guide/supervision.md")]
}
pub mod sessions {
    #![doc = include_str!("guide/sessions.md")]
}
pub mod recording {
    #![doc = include_str!("guide/recording.md")]
}
pub mod testing {
    #![doc = include_str!("guide/testing.md")]
}
pub mod performance {
    #![doc = include_str!("guide/performance.md")]
}
