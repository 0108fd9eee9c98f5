// SPDX-License-Identifier: MIT

//! Shows a mounted gauge and writes its Cell Terminate Voltage:
//! `cargo run -p gaugefs-client --example terminate_voltage /run/gauges/BAT0 3100mV`.

use std::error::Error;
use std::time::Duration;

use gaugefs_client::Gauge;

const NAME: &str = "Cell Terminate Voltage";

fn main() -> Result<(), Box<dyn Error>> {
    run(std::env::args().skip(1))
}

/// Does what the command line says: the folder of a mounted gauge, and a voltage if one is to be written.
pub(crate) fn run(mut arguments: impl Iterator<Item = String>) -> Result<(), Box<dyn Error>> {
    let path = arguments.next().ok_or("give the folder of a mounted gauge, and a voltage")?;
    let gauge = Gauge::open(path)?;
    let volts = gauge.value("voltage_now")?.in_unit("V").ok_or("it has not measured yet")?;
    println!("{}: {volts:.3} V, {}", gauge.name(), gauge.sample()?.status());
    if let Some(wanted) = arguments.next() {
        let mut transaction = gauge.transaction()?;
        transaction.set(NAME, &wanted)?;
        for change in transaction.commit()? {
            println!("{}: {} to {} {}", change.name, change.old, change.new, change.unit);
        }
    }
    println!("{NAME}: {}", gauge.parameter(NAME)?);
    if let Some(what) = gauge.unsettled()? {
        println!("a write was interrupted: {what}");
    }
    let mut follow = gauge.follow(["gauge/flags"])?;
    match follow.next(Some(Duration::from_secs(10))) {
        Some(Ok(texts)) => println!("flags: {}", texts.get("gauge/flags").map_or("none", String::as_str)),
        Some(Err(why)) => println!("nothing to see: {why}"),
        None => println!("no poll"),
    }
    Ok(())
}
