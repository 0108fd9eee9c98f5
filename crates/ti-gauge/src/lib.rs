//! Texas Instruments fuel gauges: what each part's manual says, as tables, and what can be done with a gauge
//! on a bus.

pub mod authentication;
pub mod chip;
pub mod codec;
pub mod dataflash;
pub mod error;
pub mod gauge;
pub mod image;
pub mod journal;
pub mod keys;
pub mod probe;
pub mod registers;
pub mod text;
pub mod value;
