//! Liquids and bleeding.

mod bleeding;
mod liquid;
mod reference;
mod viscous;
