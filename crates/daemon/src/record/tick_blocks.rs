//! Blocks of ticks as a log holds them: every number with all its bits, in columns, and a fingerprint of each tick's sample
//! by which a replay knows whether it does the same. How long a tick's stages took is noise that nothing follows from: it is
//! left out, and a viewer's samples have the longest of each 20 ms.

use crate::control::flange_sensor::FlangeReading;
use crate::control::plant::SourceAge;
use crate::control::tick_input::{Slot, TickInput};
use crate::record::tick_log::{PortEvent, TickRecord};
use crate::robot::JOINTS;
use anyhow::{Context, Result, ensure};
use moca_msgs::{ArmLink, Fault, GripperState, Outcome, Request, RobotState, Sample, nanoseconds};
use moca_telemetry::log::columns::{ColumnReader, ColumnWriter, DamagedColumns, Rate};
use serde::{Deserialize, Serialize};
use std::collections::VecDeque;

/// Ticks of one block: a quarter of a second at 1 kHz.
pub const BLOCK_TICKS: usize = 250;
/// Ticks that wait for their samples at most; later ones go without.
const WAITING_MAX: usize = 8192;
/// Room for an encoded sample, bytes; a longer one takes more.
const SAMPLE_BYTES: usize = 2048;
/// Flags of a tick.
const STATE_KNOWN: u64 = 1;
const WRENCH_KNOWN: u64 = 2;
const SAMPLE_KNOWN: u64 = 4;
const FLANGE_KNOWN: u64 = 8;

/// A tick and the fingerprint of its sample; `None` where the sample never came.
#[derive(Clone, Debug, PartialEq)]
pub struct ComparedTick {
    /// Inputs and answers of the tick.
    pub record: TickRecord,
    /// See [`fingerprint`].
    pub sample: Option<u32>,
}

/// A checksum over every bit of a sample but the times of its stages: 1 of 4 billion other samples has the same.
pub fn fingerprint(sample: &Sample) -> u32 {
    let timeless = Sample { stages_ns: Default::default(), ..sample.clone() };
    // A sample always encodes.
    crc32fast::hash(&postcard::to_extend(&timeless, Vec::with_capacity(SAMPLE_BYTES)).unwrap_or_default())
}

/// Joins ticks and samples, which come through different rings, into blocks.
#[derive(Debug, Default)]
pub struct BlockBuilder {
    period_s: f64,
    ticks: VecDeque<TickRecord>,
    samples: VecDeque<(u64, u32)>,
    block: Vec<ComparedTick>,
}

/// A block and the loop time of its last tick, ns.
pub type Block = (u64, Vec<u8>);

impl BlockBuilder {
    /// For a loop of this period, s.
    pub fn new(period_s: f64) -> Self {
        Self { period_s, ..Self::default() }
    }

    /// Adds what one tick was given.
    pub fn tick(&mut self, record: TickRecord) -> Option<Block> {
        self.ticks.push_back(record);
        self.put_together(self.ticks.len() > WAITING_MAX)
    }

    /// Adds one sample.
    pub fn sample(&mut self, sample: &Sample) -> Option<Block> {
        self.samples.push_back((sample.tick, fingerprint(sample)));
        if self.samples.len() > WAITING_MAX {
            self.samples.pop_front();
        }
        self.put_together(false)
    }

    /// The last block: ticks whose samples have not come go without.
    pub fn finish(&mut self) -> Vec<Block> {
        let mut blocks = Vec::new();
        while !self.ticks.is_empty() {
            blocks.extend(self.put_together(true));
        }
        if !self.block.is_empty() {
            blocks.push(self.take());
        }
        blocks
    }

    fn put_together(&mut self, oldest_goes: bool) -> Option<Block> {
        let mut oldest_goes = oldest_goes;
        while self.block.len() < BLOCK_TICKS
            && let Some(tick) = self.ticks.front().map(|record| record.input.slot.tick)
        {
            while self.samples.front().is_some_and(|(of, _)| *of < tick) {
                self.samples.pop_front();
            }
            if self.samples.is_empty() && !std::mem::take(&mut oldest_goes) {
                break;
            }
            let sample = self.samples.pop_front_if(|(of, _)| *of == tick).map(|(_, print)| print);
            self.block.extend(self.ticks.pop_front().map(|record| ComparedTick { record, sample }));
        }
        (self.block.len() >= BLOCK_TICKS).then(|| self.take())
    }

    fn take(&mut self) -> Block {
        let last_ns = self.block.last().map_or(0, |tick| tick.record.input.slot.now_ns);
        let bytes = encode(&self.block, self.period_s);
        self.block.clear();
        (last_ns, bytes)
    }
}

/// Values that few ticks have, each with the tick's place in the block.
#[derive(Debug, Default, PartialEq, Serialize, Deserialize)]
struct Rare {
    no_state: Vec<(u32, Fault)>,
    requests: Vec<(u32, Request)>,
    outcomes: Vec<(u32, Outcome)>,
    refused: Vec<(u32, Fault)>,
    /// Events of the first board.
    events: Vec<(u32, PortEvent)>,
}

/// Events of further boards, each with the tick's place in the block and the board.
type Further = Vec<(u32, u8, PortEvent)>;

/// Reports of the arm on itself where they change; nothing before the first.
type Links = Vec<(u32, Option<ArmLink>)>;

/// Reports of the gripper where they change; nothing before the first.
type Grippers = Vec<(u32, Option<GripperState>)>;

/// Returns a report of each tick where it changes, with the tick's place in the block; nothing before the first.
fn changes<T: Copy + PartialEq>(
    ticks: &[ComparedTick],
    of: impl Fn(&TickInput) -> Option<T>,
) -> Vec<(u32, Option<T>)> {
    let mut last = None;
    let reports = (0..).zip(ticks.iter().map(|tick| of(&tick.record.input)));
    reports.filter(|(_, report)| std::mem::replace(&mut last, *report) != *report).collect()
}

/// Gives every tick the report of [`changes`].
fn give<T: Copy>(
    ticks: &mut [ComparedTick],
    changes: Vec<(u32, Option<T>)>,
    set: impl Fn(&mut TickInput, Option<T>),
) {
    let (mut report, mut changes) = (None, changes.into_iter().peekable());
    for (row, tick) in (0..).zip(ticks) {
        if let Some((_, changed)) = changes.next_if(|(of, _)| *of == row) {
            report = changed;
        }
        set(&mut tick.record.input, report);
    }
}

impl Rare {
    fn of(ticks: &[ComparedTick]) -> Self {
        let mut rare = Self::default();
        for (row, ComparedTick { record, .. }) in (0..).zip(ticks) {
            let input = &record.input;
            rare.no_state.extend(input.state.err().map(|fault| (row, fault)));
            rare.requests.extend(input.request.map(|request| (row, request)));
            rare.outcomes.extend(input.outcome.map(|outcome| (row, outcome)));
            rare.refused.extend(input.refused.map(|fault| (row, fault)));
            let of_first = record.events.iter().filter(|(board, _)| *board == 0);
            rare.events.extend(of_first.map(|(_, event)| (row, event.clone())));
        }
        rare
    }

    fn further(ticks: &[ComparedTick]) -> Further {
        let of_tick = |(row, tick): (u32, &ComparedTick)| {
            let further = tick.record.events.iter().filter(|(board, _)| *board > 0);
            further.map(move |(board, event)| (row, *board, event.clone())).collect::<Further>()
        };
        (0..).zip(ticks).flat_map(of_tick).collect()
    }
}

/// `period_s` is the loop's period: it helps to predict angles from their rates, s.
pub fn encode(ticks: &[ComparedTick], period_s: f64) -> Vec<u8> {
    let mut out = ColumnWriter::default();
    let slots: Vec<Slot> = ticks.iter().map(|tick| tick.record.input.slot).collect();
    let integers = |of: &dyn Fn(&Slot) -> u64| -> Vec<u64> { slots.iter().map(of).collect() };
    out.integers(&integers(&|slot| slot.tick));
    // When it was due goes on in equal steps: what it was late is noise, and is paid for once.
    out.integers(&integers(&|slot| slot.now_ns.wrapping_sub(nanoseconds(slot.lateness_s))));
    out.integers(&integers(&|slot| slot.ticks));
    out.integers(&integers(&|slot| slot.overruns));
    let record =
        |of: &dyn Fn(&TickRecord) -> u64| -> Vec<u64> { ticks.iter().map(|t| of(&t.record)).collect() };
    out.integers(&record(&|record| record.number));
    out.integers(&record(&|record| record.lost));
    out.integers(&record(&|record| record.input.cover_events));
    out.integers(&ticks.iter().map(flags).collect::<Vec<_>>());
    let numbers =
        |of: &dyn Fn(&TickInput) -> f64| -> Vec<f64> { ticks.iter().map(|t| of(&t.record.input)).collect() };
    out.numbers(&numbers(&|input| input.slot.lateness_s), None);
    out.numbers(&numbers(&|input| input.age.arm_s), None);
    out.numbers(&numbers(&|input| input.age.base_s), None);

    let known: Vec<(f64, RobotState<JOINTS>)> = ticks
        .iter()
        .filter_map(|t| Some((step_s(&t.record.input.slot, period_s), t.record.input.state.ok()?)))
        .collect();
    out.numbers(&[period_s], None);
    let step_s: Vec<f64> = known.iter().map(|(step_s, _)| *step_s).collect();
    let column = |of: &dyn Fn(&RobotState<JOINTS>) -> f64| -> Vec<f64> {
        known.iter().map(|(_, state)| of(state)).collect()
    };
    let mut moved = |value: &dyn Fn(&RobotState<JOINTS>) -> f64,
                     rate: &dyn Fn(&RobotState<JOINTS>) -> f64| {
        let per_s = column(rate);
        out.numbers(&per_s, None);
        out.numbers(&column(value), Some(Rate { per_s: &per_s, step_s: &step_s }));
    };
    for axis in 0..3 {
        moved(&|state| state.base_pose_world[axis], &|state| state.base_velocity_world[axis]);
    }
    for joint in 0..JOINTS {
        moved(&|state| state.q_rad[joint], &|state| state.dq_rad_s[joint]);
    }
    for joint in 0..JOINTS {
        out.numbers(&column(&|state| state.torque_measured_nm[joint]), None);
    }
    let wrenches: Vec<[f64; 6]> = known.iter().filter_map(|(_, state)| state.flange_wrench_world).collect();
    for axis in 0..6 {
        out.numbers(&wrenches.iter().map(|wrench| wrench[axis]).collect::<Vec<_>>(), None);
    }
    out.blob(&ticks.iter().filter_map(|tick| tick.sample).flat_map(u32::to_le_bytes).collect::<Vec<_>>());
    // These types always encode; an empty record would be refused by whoever reads it.
    let mut rare = postcard::to_stdvec(&Rare::of(ticks)).unwrap_or_default();
    let further = Rare::further(ticks);
    let links = changes(ticks, |input| input.link);
    let grippers = changes(ticks, |input| input.gripper);
    // After everything else, so that the log of a single board, and of a robot without a gripper, keeps its form.
    if !(further.is_empty() && links.is_empty() && grippers.is_empty()) {
        rare.extend(postcard::to_stdvec(&(further, links)).unwrap_or_default());
    }
    if !grippers.is_empty() {
        rare.extend(postcard::to_stdvec(&grippers).unwrap_or_default());
    }
    out.blob(&rare);
    // Last, so that the log of a robot without a flange sensor keeps its form.
    let readings: Vec<FlangeReading> = ticks.iter().filter_map(|tick| tick.record.input.flange).collect();
    if !readings.is_empty() {
        out.numbers(&readings.iter().map(|reading| reading.age_s).collect::<Vec<_>>(), None);
        for axis in 0..6 {
            out.numbers(&readings.iter().map(|reading| reading.wrench[axis]).collect::<Vec<_>>(), None);
        }
    }
    out.finish()
}

fn flags(tick: &ComparedTick) -> u64 {
    let state = tick.record.input.state;
    let flag = |set: bool, flag: u64| if set { flag } else { 0 };
    flag(state.is_ok(), STATE_KNOWN)
        | flag(state.is_ok_and(|state| state.flange_wrench_world.is_some()), WRENCH_KNOWN)
        | flag(tick.sample.is_some(), SAMPLE_KNOWN)
        | flag(tick.record.input.flange.is_some(), FLANGE_KNOWN)
}

fn step_s(slot: &Slot, period_s: f64) -> f64 {
    #[expect(clippy::cast_precision_loss, reason = "a count of missed slots")]
    let ticks = slot.ticks as f64;
    period_s * ticks
}

/// The columns of a block, read one after the other.
struct Columns<'a> {
    reader: ColumnReader<'a>,
    rows: usize,
}

impl Columns<'_> {
    fn integers(&mut self) -> Result<Vec<u64>, DamagedColumns> {
        let column = self.reader.integers()?;
        if column.len() == self.rows { Ok(column) } else { Err(DamagedColumns) }
    }

    fn numbers(&mut self, rate: Option<Rate<'_>>, rows: usize) -> Result<Vec<f64>, DamagedColumns> {
        let column = self.reader.numbers(rate)?;
        if column.len() == rows { Ok(column) } else { Err(DamagedColumns) }
    }

    /// The slots, which are not late yet.
    fn slots(&mut self) -> Result<Vec<Slot>> {
        let (tick, due_ns) = (self.reader.integers()?, self.reader.integers()?);
        self.rows = tick.len();
        ensure!(due_ns.len() == self.rows, DamagedColumns);
        let (ticks, overruns) = (self.integers()?, self.integers()?);
        let slot = |row: usize| Slot {
            tick: tick[row],
            now_ns: due_ns[row],
            ticks: ticks[row],
            overruns: overruns[row],
            ..Slot::default()
        };
        Ok((0..self.rows).map(slot).collect())
    }

    /// The states of the ticks that have one, whose wrenches are still unknown.
    fn states(&mut self, slots: &[Slot]) -> Result<Vec<RobotState<JOINTS>>, DamagedColumns> {
        let rows = slots.len();
        let period_s = self.numbers(None, 1)?[0];
        let step_s: Vec<f64> = slots.iter().map(|slot| step_s(slot, period_s)).collect();
        let nowhere = RobotState::at_rest([0.0; JOINTS]);
        let mut states = vec![nowhere; rows];
        for axis in 0..3 {
            let per_s = self.numbers(None, rows)?;
            let values = self.numbers(Some(Rate { per_s: &per_s, step_s: &step_s }), rows)?;
            for (state, (value, rate)) in states.iter_mut().zip(values.into_iter().zip(per_s)) {
                (state.base_pose_world[axis], state.base_velocity_world[axis]) = (value, rate);
            }
        }
        for joint in 0..JOINTS {
            let per_s = self.numbers(None, rows)?;
            let values = self.numbers(Some(Rate { per_s: &per_s, step_s: &step_s }), rows)?;
            for (state, (value, rate)) in states.iter_mut().zip(values.into_iter().zip(per_s)) {
                (state.q_rad[joint], state.dq_rad_s[joint]) = (value, rate);
            }
        }
        for joint in 0..JOINTS {
            for (state, torque) in states.iter_mut().zip(self.numbers(None, rows)?) {
                state.torque_measured_nm[joint] = torque;
            }
        }
        Ok(states)
    }
}

/// The ticks of [`encode`].
///
/// # Errors
/// A block of another version, or damaged.
pub fn decode(bytes: &[u8]) -> Result<Vec<ComparedTick>> {
    let mut columns = Columns { reader: ColumnReader::new(bytes), rows: 0 };
    let mut slots = columns.slots()?;
    let rows = slots.len();
    let (number, lost, cover_events) = (columns.integers()?, columns.integers()?, columns.integers()?);
    let flags = columns.integers()?;
    let has = |row: usize, flag: u64| flags[row] & flag != 0;
    let lateness_s = columns.numbers(None, rows)?;
    for (slot, lateness_s) in slots.iter_mut().zip(lateness_s) {
        slot.now_ns = slot.now_ns.wrapping_add(nanoseconds(lateness_s));
        slot.lateness_s = lateness_s;
    }
    let (arm_s, base_s) = (columns.numbers(None, rows)?, columns.numbers(None, rows)?);
    let known: Vec<usize> = (0..rows).filter(|row| has(*row, STATE_KNOWN)).collect();
    let known_slots: Vec<Slot> = known.iter().map(|row| slots[*row]).collect();
    let mut states = columns.states(&known_slots)?;
    let felt: Vec<usize> = (0..known.len()).filter(|i| has(known[*i], WRENCH_KNOWN)).collect();
    for axis in 0..6 {
        for (i, value) in felt.iter().zip(columns.numbers(None, felt.len())?) {
            states[*i].flange_wrench_world.get_or_insert_default()[axis] = value;
        }
    }
    let prints = columns.reader.blob()?;
    let mut prints =
        prints.chunks_exact(4).filter_map(|print| Some(u32::from_le_bytes(print.try_into().ok()?)));
    let (rare, behind): (Rare, &[u8]) = postcard::take_from_bytes(columns.reader.blob()?)?;
    let measured: Vec<usize> = (0..rows).filter(|row| has(*row, FLANGE_KNOWN)).collect();
    let mut readings = vec![None; rows];
    if !measured.is_empty() {
        for (row, age_s) in measured.iter().zip(columns.numbers(None, measured.len())?) {
            readings[*row] = Some(FlangeReading { wrench: [0.0; 6], age_s });
        }
        for axis in 0..6 {
            for (reading, value) in readings.iter_mut().flatten().zip(columns.numbers(None, measured.len())?)
            {
                reading.wrench[axis] = value;
            }
        }
    }
    let ((further, links), behind): ((Further, Links), &[u8]) =
        if behind.is_empty() { Default::default() } else { postcard::take_from_bytes(behind)? };
    let grippers: Grippers =
        if behind.is_empty() { Grippers::default() } else { postcard::from_bytes(behind)? };

    let mut states = states.into_iter();
    let mut ticks = Vec::with_capacity(rows);
    for row in 0..rows {
        let state = if has(row, STATE_KNOWN) { states.next().map(Ok) } else { Some(Err(Fault::PlantLost)) };
        let input = TickInput {
            slot: slots[row],
            state: state.context("a state is missing")?,
            age: SourceAge { arm_s: arm_s[row], base_s: base_s[row] },
            link: None,
            flange: readings[row],
            gripper: None,
            request: None,
            outcome: None,
            refused: None,
            cover_events: cover_events[row],
        };
        let record = TickRecord { input, number: number[row], lost: lost[row], events: Vec::new() };
        let sample = if has(row, SAMPLE_KNOWN) {
            Some(prints.next().context("a fingerprint is missing")?)
        } else {
            None
        };
        ticks.push(ComparedTick { record, sample });
    }
    give(&mut ticks, links, |input, link| input.link = link);
    give(&mut ticks, grippers, |input, gripper| input.gripper = gripper);
    put(&mut ticks, rare.no_state, |record, fault| record.input.state = Err(fault))?;
    put(&mut ticks, rare.requests, |record, request| record.input.request = Some(request))?;
    put(&mut ticks, rare.outcomes, |record, outcome| record.input.outcome = Some(outcome))?;
    put(&mut ticks, rare.refused, |record, fault| record.input.refused = Some(fault))?;
    put(&mut ticks, rare.events, |record, event| record.events.push((0, event)))?;
    let further = further.into_iter().map(|(row, board, event)| (row, (board, event))).collect();
    put(&mut ticks, further, |record, event| record.events.push(event))?;
    Ok(ticks)
}

fn put<T>(
    ticks: &mut [ComparedTick],
    rare: Vec<(u32, T)>,
    mut set: impl FnMut(&mut TickRecord, T),
) -> Result<()> {
    for (row, value) in rare {
        let tick = usize::try_from(row).ok().and_then(|row| ticks.get_mut(row));
        set(&mut tick.context("a block names a tick that it does not hold")?.record, value);
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;
    use moca_msgs::{Mode, Refusal};

    fn tick(number: u64) -> ComparedTick {
        let x = f64::from(u32::try_from(number).unwrap()) * 0.37;
        let state = RobotState {
            base_pose_world: [-0.0, f64::MIN_POSITIVE, x],
            base_velocity_world: [f64::INFINITY, x.sin(), 0.1],
            q_rad: [f64::from_bits(0x7ff8_0000_0000_0123); JOINTS],
            dq_rad_s: [5e-324; JOINTS],
            torque_measured_nm: [87.0 * x.cos(); JOINTS],
            flange_wrench_world: number.is_multiple_of(3).then_some([x; 6]),
        };
        let pressed = Request::PressTaxel { taxel: 5, force_n: 20.0 };
        let input = TickInput {
            slot: Slot {
                tick: number,
                now_ns: number * 1_000_017,
                ticks: 1 + number % 2,
                lateness_s: x * 1e-5,
                overruns: number / 7,
                stages_ns: [0; 5],
            },
            state: if number % 11 == 5 { Err(Fault::BaseStale) } else { Ok(state) },
            age: SourceAge { arm_s: x, base_s: 2.0 * x },
            request: number.is_multiple_of(10).then_some(pressed),
            outcome: number.is_multiple_of(10).then_some(Err(Refusal::Mode(Mode::Ready))),
            link: (!(number / 30).is_multiple_of(3))
                .then(|| ArmLink { lost: number / 40, ..ArmLink::default() }),
            flange: (number > 20)
                .then_some(FlangeReading { wrench: [x, -x, f64::NAN, -0.0, 1e9, 3.0 * x], age_s: 0.1 * x }),
            gripper: (!(number / 40).is_multiple_of(2)).then(|| GripperState {
                width_m: x,
                requests: u32::try_from(number / 30).unwrap(),
                ..GripperState::default()
            }),
            refused: (number == 17).then_some(Fault::PlantLost),
            cover_events: number / 4,
        };
        let bytes = |n: u64| PortEvent::Bytes(n, vec![0, 0xff, b'\n']);
        let events = if number.is_multiple_of(4) {
            vec![(0, bytes(number)), (1, PortEvent::Gap(number, 3))]
        } else {
            vec![]
        };
        let record = TickRecord { input, number, lost: number / 50, events };
        ComparedTick {
            record,
            sample: (!number.is_multiple_of(5)).then_some(0xdead_beef ^ u32::try_from(number).unwrap()),
        }
    }

    #[test]
    fn every_bit_of_every_tick_comes_back() {
        let ticks: Vec<ComparedTick> = (0..250).map(tick).collect();
        let bytes = encode(&ticks, 1e-3);
        let back = decode(&bytes).unwrap();
        // NaN is not equal to itself: their bytes are.
        assert_eq!(encode(&back, 1e-3), bytes);
        let bits = |ticks: &[ComparedTick]| -> Vec<Vec<u8>> {
            ticks.iter().map(|tick| postcard::to_stdvec(&tick.record).unwrap()).collect()
        };
        assert_eq!(bits(&back), bits(&ticks));
        assert!(back.iter().map(|tick| tick.sample).eq(ticks.iter().map(|tick| tick.sample)));
    }

    #[test]
    fn a_fingerprint_is_of_everything_but_how_long_the_stages_took() {
        let sample = Sample { tick: 7, lateness_s: 1e-5, ..Sample::default() };
        let slower = Sample { stages_ns: [9; 5], ..sample.clone() };
        let later = Sample { lateness_s: 2e-5, ..sample.clone() };
        assert_eq!(fingerprint(&slower), fingerprint(&sample));
        assert_ne!(fingerprint(&later), fingerprint(&sample));
    }

    #[test]
    fn damaged_block_is_error_or_another_valid_block() {
        let bytes = encode(&(0..40).map(tick).collect::<Vec<_>>(), 1e-3);
        for at in 0..bytes.len() {
            assert!(decode(&bytes[..at]).is_err(), "cut at {at}");
            let mut damaged = bytes.clone();
            damaged[at] ^= 0x80;
            if let Ok(ticks) = decode(&damaged) {
                assert!(ticks.len() <= 40);
            }
        }
    }

    #[test]
    fn ticks_and_samples_pair_in_any_order_despite_losses() {
        let mut builder = BlockBuilder::new(1e-3);
        let sample = |tick: u64| Sample { tick, ..Sample::default() };
        let mut blocks = Vec::new();
        (0..100).for_each(|n| blocks.extend(builder.tick(tick(n).record)));
        (0..200).filter(|n| *n != 150).for_each(|n| blocks.extend(builder.sample(&sample(n))));
        (100..260).for_each(|n| blocks.extend(builder.tick(tick(n).record)));
        blocks.extend(builder.finish());
        let ticks: Vec<ComparedTick> = blocks.iter().flat_map(|(_, block)| decode(block).unwrap()).collect();
        assert!(ticks.iter().map(|tick| tick.record.number).eq(0..260));
        for ComparedTick { record, sample: found } in ticks {
            let number = record.number;
            let expected = (number < 200 && number != 150).then(|| fingerprint(&sample(number)));
            assert_eq!(found, expected, "tick {number}");
        }
    }
}
