// SPDX-License-Identifier: MIT

use bq34z100::{Bq34z100g1, Bq34z100g1Driver};
use linux_embedded_hal::{Delay, I2cdev};

use crate::{Told, celsius, milli, show, told};

type Driver = Bq34z100g1Driver<I2cdev, Delay>;

pub fn run(i2c: I2cdev, action: &str, numbers: &[i32]) -> Told<()> {
    let mut gauge = Driver { i2c, delay: Delay, flash_block_data: [0; 32] };
    match (action, numbers) {
        ("read", []) => read(&mut gauge),
        ("design-capacity", [mah]) => told(gauge.update_design_capacity(*mah as u16))?,
        ("q-max", [mah]) => told(gauge.update_q_max(*mah as i16))?,
        ("design-energy", [energy, scale]) => told(gauge.update_design_energy(*energy as i16, *scale as u8))?,
        ("charge-voltages", [cold, mild, hot]) => {
            told(gauge.update_cell_charge_voltage_range(*cold as u16, *mild as u16, *hot as u16))?
        }
        ("series-cells", [cells]) => told(gauge.update_number_of_series_cells(*cells as u8))?,
        ("pack-configuration", [word]) => told(gauge.update_pack_configuration(*word as u16))?,
        ("charge-termination", [current, capacity, voltage, window, percents @ ..])
            if percents.len() == 4 =>
        {
            let percent = |at: usize| percents[at] as i8;
            told(gauge.update_charge_termination_parameters(
                *current as i16,
                *capacity as i16,
                *voltage as i16,
                *window as u8,
                percent(0),
                percent(1),
                percent(2),
                percent(3),
            ))?
        }
        ("led-mode", [mode]) => told(gauge.set_led_mode(*mode as u8))?,
        ("cc-offset", []) => told(gauge.calibrate_cc_offset())?,
        ("board-offset", []) => told(gauge.calibrate_board_offset())?,
        ("voltage-divider", [applied]) => told(gauge.calibrate_voltage_divider(*applied as f32))?,
        ("sense-resistor", [applied]) => told(gauge.calibrate_sense_resistor(*applied as i16))?,
        ("ready", []) => told(gauge.ready())?,
        ("flash-stream", []) => {
            for line in std::io::stdin().lines() {
                let line = told(line)?;
                if !line.is_empty() {
                    told(gauge.write_flash_stream_i2c(&line, false))?;
                }
            }
        }
        _ => return Err(format!("no action {action} with {} numbers", numbers.len())),
    }
    Ok(())
}

fn read(gauge: &mut Driver) {
    show("capacity", told(gauge.state_of_charge()));
    show("capacity_error_margin", told(gauge.state_of_charge_max_error()));
    show("charge_now", told(gauge.remaining_capacity()).map(milli));
    show("charge_full", told(gauge.full_charge_capacity()).map(milli));
    show("charge_full_design", told(gauge.design_capacity()).map(milli));
    show("voltage_now", told(gauge.voltage()).map(milli));
    show("current_now", told(gauge.current()).map(milli));
    show("current_avg", told(gauge.average_current()).map(milli));
    show("temp", told(gauge.temperature()).map(celsius));
    show("cycle_count", told(gauge.cycle_count()));
    show("state_of_health", told(gauge.state_of_health()));
    show("serial_number", told(gauge.serial_number()).map(|word| format!("{word:04x}")));
    show("constant_charge_current", told(gauge.charge_current()).map(milli));
    // 65535 is no time: gaugefs has no such file then.
    for (file, minutes) in [
        ("time_to_empty_now", told(gauge.average_time_to_empty())),
        ("time_to_full_now", told(gauge.average_time_to_full())),
    ] {
        if minutes != Ok(u16::MAX) {
            show(file, minutes.map(|minutes| 60 * u32::from(minutes)));
        }
    }
    show("gauge/device_type", told(gauge.device_type()).map(hex));
    show("gauge/hardware_version", told(gauge.hw_version()).map(hex));
    show("gauge/firmware_version", told(gauge.fw_version()).map(hex));
    show("gauge/chem_id", told(gauge.chem_id()).map(hex));
    for (name, word) in [
        ("pack_configuration", told(gauge.pack_configuration())),
        ("flags", told(gauge.flags())),
        ("flags_b", told(gauge.flags_b())),
        ("charge_voltage", told(gauge.charge_voltage())),
        ("passed_charge", told(gauge.passed_charge())),
        ("dod0_time", told(gauge.do_d0_time())),
        ("internal_temperature", told(gauge.internal_temperature())),
        ("grid_number", told(gauge.grid_number()).map(u16::from)),
        ("learned_status", told(gauge.learned_status()).map(u16::from)),
        ("dod_at_eoc", told(gauge.dod_at_eoc())),
        ("qstart", told(gauge.q_start())),
        ("true_fcc", told(gauge.true_fcc())),
        ("state_time", told(gauge.state_time())),
        ("qmax_passed_q", told(gauge.q_max_passed_q())),
        ("dod0", told(gauge.dod_0())),
        ("qmax_dod0", told(gauge.q_max_dod_0())),
        ("qmax_time", told(gauge.q_max_time())),
    ] {
        show(&format!("gauge/registers/{name}"), word);
    }
    // In 10 mWh and 10 mW, as its documentation has them.
    show("energy_now", told(gauge.available_energy()).map(|word| 10_000 * u64::from(word)));
    // 0 unless it is discharged: gaugefs has no such file then.
    let power = told(gauge.average_power());
    if power != Ok(0) {
        show("power_avg", power.map(|word| 10_000 * i64::from(word as i16)));
    }
}

fn hex(word: u16) -> String {
    format!("{word:#06x}")
}
