//! Checks that need the unsealed gauge: whether the table's addresses are this firmware's, whether the
//! voltage lets the gauge program flash, and whether the values are safe.

use super::blocks::{Dirty, locate, old_bytes};
use super::io::read_word;
use super::schemes::sequence;
use super::{Change, DataFlash};
use crate::chip::{FLAT, Parameter, Safe};
use crate::codec;
use crate::error::{Cause, Error, Result, Step};
use crate::gauge::Gauge;
use crate::value::Value;

impl DataFlash {
    /// Checks, before the first write, rows with known content, which show whether this firmware keeps its
    /// data flash at the addresses in the table.
    pub(super) fn check_signature(&mut self, gauge: &mut Gauge) -> Result<()> {
        if self.signed {
            return Ok(());
        }
        for row in gauge.chip.signature {
            let size = row.kind.size();
            let (start, offset) = (if row.subclass == FLAT { row.offset } else { 0 }, row.offset);
            let (place, at) = locate(row.subclass, start, offset);
            let window = sequence(gauge).load(gauge, place)?;
            let Value::Int(found) = codec::decode(row.kind, &window[at..at + size]) else { continue };
            if !(row.min..=row.max).contains(&found) {
                let why = format!(
                    "{} holds {found}, which cannot be: this firmware keeps its data flash elsewhere, and nothing \
                     is written to it",
                    place.name(at)
                );
                return Err(Error::new("", Cause::Gone(why)).at(Step::Check));
            }
        }
        self.signed = true;
        Ok(())
    }

    /// Reads the limit and the divider of the flash-voltage gate, unless they are known. UNSEALED only.
    pub(super) fn learn_gate(&mut self, gauge: &mut Gauge) -> Result<()> {
        let Some(gate) = &gauge.chip.gate else { return Ok(()) };
        if self.gate.is_none() {
            let limit_mv = read_word(gauge, gate.limit)?;
            let divider = match gate.divider {
                Some((subclass, offset, _)) => read_word(gauge, (subclass, offset))?,
                None => 0,
            };
            self.gate = Some((limit_mv, divider));
        }
        Ok(())
    }

    /// Voltage() as the gate compares it, per cell if the part has a divider, and the limit.
    fn gate_voltage(&self, gauge: &Gauge, voltage_mv: u16) -> Option<(u32, u16)> {
        let (limit_mv, divider) = self.gate?;
        let scaled_mv = match gauge.chip.gate.as_ref()?.divider {
            Some((_, _, full)) if divider != 0 => u32::from(voltage_mv) * full / u32::from(divider),
            Some(_) | None => u32::from(voltage_mv),
        };
        Some((scaled_mv, limit_mv))
    }

    pub(super) fn check_gate(&mut self, gauge: &mut Gauge, voltage_mv: u16) -> Result<()> {
        self.learn_gate(gauge)?;
        let (Some(gate), Some((scaled_mv, limit_mv))) =
            (&gauge.chip.gate, self.gate_voltage(gauge, voltage_mv))
        else {
            return Ok(());
        };
        if scaled_mv >= u32::from(limit_mv) {
            return Ok(());
        }
        let (subclass, offset) = gate.limit;
        let why = format!(
            "the gauge measures {scaled_mv} mV per cell and stores nothing below {limit_mv} mV ({subclass}/{offset}): \
             charge the pack, or check Voltage Divider"
        );
        Err(Error::new("", Cause::NotNow(why)).at(Step::Check))
    }

    /// Checks the safety limits, which are narrower than the manual's.
    pub(super) fn check_safe(
        &self,
        gauge: &Gauge,
        change: &Change,
        dirty: &[Dirty],
        voltage_mv: u16,
    ) -> Result<()> {
        let refuse = |why: String| Err(Error::new(change.subject(), Cause::OutOfRange(why)).at(Step::Check));
        let Some((_, parameter)) = change.row else { return Ok(()) };
        let number = integer(parameter, &change.bytes);
        match &parameter.safe {
            Some(Safe::AtLeast(..)) => change.check_least(),
            Some(Safe::BelowPresentVoltage(why)) => {
                let present_mv =
                    i64::from(self.gate_voltage(gauge, voltage_mv).map_or(0, |(scaled_mv, _)| scaled_mv));
                if number <= present_mv {
                    return Ok(());
                }
                refuse(format!("{number} is above the present {present_mv} mV per cell: {why}"))
            }
            Some(Safe::Keep(..)) if change.saved => Ok(()),
            Some(Safe::Keep(mask, why)) => {
                let old = integer(parameter, &old_bytes(change, dirty));
                let differ = (old ^ number) & i64::from(*mask);
                if differ == 0 {
                    return Ok(());
                }
                refuse(format!("bits 0x{differ:x} must not change: {why}; the word is now 0x{old:x}"))
            }
            None => Ok(()),
        }
    }
}

pub(super) fn is_gate(gauge: &Gauge, change: &Change) -> bool {
    let at = (change.place.subclass, change.place.offset);
    gauge.chip.gate.as_ref().is_some_and(|gate| {
        at == gate.limit || gate.divider.is_some_and(|(subclass, offset, _)| at == (subclass, offset))
    })
}

/// The number that a parameter's bytes encode; all safety limits are on integers.
pub(super) fn integer(parameter: &Parameter, bytes: &[u8]) -> i64 {
    match codec::decode(parameter.kind, bytes) {
        Value::Int(number) => number,
        Value::Float(_) | Value::Text(_) => 0,
    }
}
