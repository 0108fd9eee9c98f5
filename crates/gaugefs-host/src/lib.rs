// SPDX-License-Identifier: MIT

//! What gaugefs's commands share: the facts of an [error] as JSON, the checked way to
//! [standard output and standard error](output), [files](input) and [programs](program) that a person names, gaugefs's
//! own [folders], and the [signs](sign) of a production line.
//!
//! It is not meant for other programs: they use `gaugefs-client`.
//!
//! ```
//! use std::time::Duration;
//!
//! use gaugefs_host::error::Error;
//! use gaugefs_host::seconds;
//!
//! assert_eq!(seconds("2min", (1.0, 600.0)), Ok(Duration::from_secs(120)));
//!
//! let missing = std::fs::read("/does/not/exist").expect_err("it is missing");
//! let error = Error::io("the key file", "read", &missing);
//! assert_eq!(error.errno(), 2, "{error}");
//! ```

#![deny(clippy::print_stdout, clippy::print_stderr)]

use std::time::Duration;

use ti_gauge::unit;

pub mod chemistry;
pub mod error;
pub mod folders;
pub mod input;
pub mod output;
pub mod program;
pub mod sign;
pub mod signals;

/// A time from a command line or a configuration file: in seconds, or with a unit such as `2min`.
pub fn seconds(text: &str, (least, most): (f64, f64)) -> Result<Duration, String> {
    let seconds = text.parse().ok().or_else(|| unit::measured(text, "s"));
    match seconds.filter(|seconds| (least..=most).contains(seconds)) {
        Some(seconds) => Ok(Duration::from_secs_f64(seconds)),
        None => Err(format!("expected {least} to {most} seconds, or a time such as 2min")),
    }
}
