//! Controllers of liquids, smoke, bleeding and vital signs.

pub mod bleeding;
pub mod irrigation;
pub mod liquid;
pub mod smoke;
pub mod vital_signs;
