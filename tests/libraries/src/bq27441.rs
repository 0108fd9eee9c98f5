// SPDX-License-Identifier: MIT

use bq27441::{BatteryConfig, Bq27441, ConfigureOptions, DelayMs};
use linux_embedded_hal::I2cdev;

use crate::{Told, celsius, milli, show, told};

struct Sleep;

impl DelayMs for Sleep {
    fn delay_ms(&mut self, ms: u32) {
        std::thread::sleep(std::time::Duration::from_millis(ms.into()));
    }
}

pub fn run(i2c: I2cdev, action: &str, numbers: &[i32]) -> Told<()> {
    let mut gauge = told(Bq27441::new(i2c))?;
    match (action, numbers) {
        ("read", []) => read(&mut gauge),
        ("read-memory", []) => read_memory(&mut gauge),
        ("configure", [capacity, energy, terminate, taper]) => {
            let config = BatteryConfig {
                design_capacity_mah: *capacity as u16,
                design_energy_mwh: *energy as u16,
                terminate_voltage_mv: *terminate as u16,
                taper_rate: *taper as i16,
                ..BatteryConfig::G1A_DEFAULT
            };
            told(gauge.configure_battery(&config, ConfigureOptions::default(), &mut Sleep))?;
        }
        ("golden", []) => {
            told(gauge.unseal())?;
            let snapshot = told(gauge.read_golden_snapshot())?;
            told(gauge.enter_config_mode())?;
            told(gauge.wait_for_config_mode(true, &mut Sleep))?;
            told(gauge.write_golden_snapshot(snapshot, &mut Sleep))?;
            told(gauge.soft_reset())?;
            told(gauge.wait_for_config_mode(false, &mut Sleep))?;
            told(gauge.seal())?;
        }
        _ => return Err(format!("no action {action} with {} numbers", numbers.len())),
    }
    Ok(())
}

fn read(gauge: &mut Bq27441<I2cdev>) {
    show("capacity", told(gauge.state_of_charge()));
    show("charge_now", told(gauge.remaining_capacity()).map(milli));
    show("charge_full", told(gauge.full_charge_capacity()).map(milli));
    show("charge_full_design", told(gauge.design_capacity()).map(milli));
    show("voltage_now", told(gauge.voltage()).map(milli));
    show("current_now", told(gauge.average_current()).map(milli));
    show("temp", told(gauge.temperature_raw()).map(celsius));
    show("state_of_health", told(gauge.state_of_health()));
    show("gauge/firmware_version", told(gauge.firmware_version()).map(|word| format!("{word:#06x}")));
    show("gauge/chem_id", told(gauge.chemistry_id()).map(|word| format!("{word:#06x}")));
    for (name, word) in [
        ("op_config", told(gauge.op_config()).map(|word| word.0)),
        ("nominal_available_capacity", told(gauge.nominal_available_capacity())),
        ("full_available_capacity", told(gauge.full_available_capacity())),
        ("internal_temperature", told(gauge.internal_temperature_raw())),
        ("remaining_capacity_unfiltered", told(gauge.remaining_capacity_unfiltered())),
        ("remaining_capacity_filtered", told(gauge.remaining_capacity_filtered())),
        ("full_charge_capacity_unfiltered", told(gauge.full_charge_capacity_unfiltered())),
        ("full_charge_capacity_filtered", told(gauge.full_charge_capacity_filtered())),
        ("state_of_charge_unfiltered", told(gauge.state_of_charge_unfiltered())),
    ] {
        show(&format!("gauge/registers/{name}"), word);
    }
    for (name, word) in [
        ("average_power", told(gauge.average_power())),
        ("standby_current", told(gauge.standby_current())),
        ("max_load_current", told(gauge.max_load_current())),
    ] {
        show(&format!("gauge/registers/{name}"), word);
    }
    show("flags:BAT_DET", told(gauge.is_battery_detected()));
    show("flags:DSG", told(gauge.is_discharging()));
    show("flags:FC", told(gauge.is_full_charged()));
    show("flags:ITPOR", told(gauge.needs_config_reload()));
    show("flags:OT", told(gauge.is_over_temp()));
    show("flags:UT", told(gauge.is_under_temp()));
    show("flags:CHG", told(gauge.is_charging()));
}

/// From data memory, of an unsealed gauge.
fn read_memory(gauge: &mut Bq27441<I2cdev>) {
    let config = told(gauge.unseal()).and_then(|()| told(gauge.read_battery_config()));
    let of = |field: fn(&BatteryConfig) -> i32| config.as_ref().map(field).map_err(Clone::clone);
    show("df/82/10", of(|config| config.design_capacity_mah.into()));
    show("df/82/12", of(|config| config.design_energy_mwh.into()));
    show("df/82/16", of(|config| config.terminate_voltage_mv.into()));
    show("df/82/27", of(|config| config.taper_rate.into()));
    show("df/82/29", of(|config| config.taper_voltage_mv.into()));
    show("df/82/31", of(|config| config.sleep_current_ma.into()));
    show("df/82/33", of(|config| config.charge_termination_voltage_mv.into()));
    show("df/82/0", told(gauge.qmax_cell_0()));
    show("df/81/0", of(|config| config.current_thresholds.expect("read").dsg_rate.into()));
    show("df/2/0", of(|config| config.safety.expect("read").over_temp_deci_c.into()));
    show("df/49/1", of(|config| config.discharge.expect("read").soc1_clear_pct.into()));
    show("df/36/5", of(|config| config.charge_termination.expect("read").fc_set_pct.into()));
    show("df/89/0", of(|config| config.ra_table.expect("read").entries[0].into()));
}
