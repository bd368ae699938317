//! Several logs side by side: eight filters in the lanes of one.
//!
//! Each lane goes through its own log, by its own times. In each round every lane moves to its next event, a fix
//! or a gyro sample, and those that have come to a fix use it; the others keep what they have. Logs of equal times
//! go in step, and nothing is wasted. What a lane computes does not depend on its neighbours.

use super::columns::{Columns, Measured, rows};
use super::gyro::{GyroInput, GyroModel};
use super::run::{AnyFilter, Log, Options, run};
use super::sensors::StarQuaternion;
use super::series::AttitudeSensor;
use super::state::{Attitude, AttitudeBias};
use super::writer::{State, Writer};
use crate::belief::Belief;
use crate::error::{Error, Result};
use crate::filter::Filter;
use crate::linalg::from_fn;
use crate::manifold::Family;
use crate::replay::{End, Evidence, Output, Report, Start, first_sample};
use crate::scalar::{Mask, Real, RunWide};
use crate::simulate::{keep_on, over_threads};
use std::cmp::Ordering;
use std::sync::Mutex;
use std::sync::atomic::AtomicBool;

/// One log of several, and where its results go.
pub struct Flight<'a> {
    /// The log; the gyro's noise is that of all.
    pub log: Log<'a>,
    /// What it starts from.
    pub start: Start<AttitudeBias, 6>,
    /// Output rows.
    pub columns: Columns<'a>,
    /// Rows at the measurements.
    pub measured: Measured<'a>,
}

/// How an estimate of a log ended: an error of one log is not one of the others.
type Ended = Result<End<AttitudeBias, 6>>;

/// Logs side by side.
pub const LANES: usize = 8;

/// Rounds between two calls of `poll`.
const CHUNK: usize = 1024;

/// Whether a filter runs in lanes over such a log. Other filters, direction sensors, output at a period of its own and
/// levels without lanes run one log at a time.
pub fn in_lanes(filter: &AnyFilter, log: &Log<'_>, options: &Options) -> bool {
    let known = matches!(filter, AnyFilter::Ekf(_) | AnyFilter::Ukf(_));
    let stars = log.sensors.sensors().iter().all(|s| matches!(s, AttitudeSensor::Star(_)));
    options.level.has_lanes() && known && stars && matches!(options.output, Output::Every(n) if n > 0)
}

/// Replays up to eight logs at a time, one after the other where they do not run [`in_lanes`]. Results differ from those
/// of [`run`] by rounding. `poll` is called with the number of gyro samples done and may end it all.
///
/// # Errors
/// What `poll` returns. What goes wrong with one log stands in its own result.
pub fn run_many(
    filter: &AnyFilter,
    flights: Vec<Flight<'_>>,
    options: &Options,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<Ended>> {
    let mut ends: Vec<Option<Ended>> = flights.iter().map(|_| None).collect();
    let (mut wide, mut done) = (Vec::new(), 0);
    for (place, flight) in flights.into_iter().enumerate() {
        if in_lanes(filter, &flight.log, options) {
            wide.push((place, flight));
            continue;
        }
        let samples = flight.log.gyro.t.len();
        let Flight { log, start, columns, measured } = flight;
        let mut interrupted = Ok(());
        let end = run(filter, log, &start, options, columns, measured, &mut |k| {
            interrupted = poll(done + k);
            interrupted.clone()
        });
        interrupted?;
        ends[place] = Some(end);
        done += samples;
    }
    while !wide.is_empty() {
        let group: Vec<(usize, Flight<'_>)> = wide.drain(..wide.len().min(LANES)).collect();
        let samples: usize = group.iter().map(|(_, f)| f.log.gyro.t.len()).sum();
        let (places, group): (Vec<usize>, Vec<Flight<'_>>) = group.into_iter().unzip();
        let found = match filter {
            AnyFilter::Ekf(f) => lanes(f, group, options, &mut |k| poll(done + k)),
            AnyFilter::Ukf(f) => lanes(f, group, options, &mut |k| poll(done + k)),
            _ => continue,
        }?;
        for (place, end) in places.into_iter().zip(found) {
            ends[place] = Some(end);
        }
        done += samples;
    }
    Ok(ends.into_iter().map(|end| end.unwrap_or(Err(Error::Empty { field: "log" }))).collect())
}

/// [`run_many`] over threads, eight logs to a task: the same bits for any number of them. `poll` is called on the calling
/// thread, at least 20 times a second, with the number of tasks done.
///
/// # Errors
/// What `poll` returns.
pub fn run_all(
    filter: &AnyFilter,
    flights: Vec<Flight<'_>>,
    options: &Options,
    threads: usize,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<Ended>> {
    let mut groups = Vec::new();
    let mut flights = flights.into_iter().peekable();
    while flights.peek().is_some() {
        groups.push(Mutex::new(flights.by_ref().take(LANES).collect::<Vec<_>>()));
    }
    let stop = AtomicBool::new(false);
    let task = |(): &mut (), number: u64| {
        let group = groups[number as usize].lock().map(|mut g| std::mem::take(&mut *g)).unwrap_or_default();
        run_many(filter, group, options, &mut |_| keep_on(&stop))
    };
    let done = over_threads(0..groups.len() as u64, threads, &stop, (|| (), task), poll)?;
    Ok(done.into_iter().flatten().collect())
}

/// Eight logs at most.
fn lanes<F: Filter>(
    filter: &F,
    flights: Vec<Flight<'_>>,
    options: &Options,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<Ended>> {
    let every = if let Output::Every(n) = options.output { n } else { 1 };
    let Some(model) = flights.first().map(|f| *f.log.model) else { return Ok(Vec::new()) };
    let lanes: Vec<Lane<'_>> = flights.into_iter().map(|flight| Lane::new(flight, &model, every)).collect();
    options.level.run_wide(Batch { filter, model: &model, lanes, poll }).unwrap_or(Ok(Vec::new()))
}

/// What a lane does next.
#[derive(Clone, Copy, PartialEq)]
enum Event {
    /// Uses measurement `i`.
    Fix(usize),
    /// Comes to the end of a leg, a gyro sample.
    Sample,
    /// Nothing more.
    None,
}

/// One log on its way.
struct Lane<'a> {
    writer: Writer<'a, GyroModel>,
    log: Log<'a>,
    start: Start<AttitudeBias, 6>,
    every: usize,
    t: f64,
    first: usize,
    leg: usize,
    measurement: usize,
    before: usize,
    evidence: Evidence,
    state: std::result::Result<bool, Error>,
}

impl<'a> Lane<'a> {
    fn new(flight: Flight<'a>, model: &'a GyroModel, every: usize) -> Self {
        let Flight { log, start, columns, measured } = flight;
        let rows = rows(log.gyro, log.sensors, &start, Output::Every(every));
        let fits = rows.and_then(|rows| {
            let (expected, found) = (rows.output, columns.t.len());
            if found == expected { Ok(()) } else { Err(Error::Length { field: "output column", expected, found }) }
        });
        let first = fits.and_then(|()| first_sample(log.gyro.t, start.t));
        let before = (0..log.sensors.len()).take_while(|i| log.sensors.time(*i) < start.t).count();
        Self {
            writer: Writer::new(log, model, columns, measured, false),
            log,
            every,
            t: start.t,
            leg: 0,
            measurement: before,
            before,
            evidence: Evidence::default(),
            first: *first.as_ref().unwrap_or(&0),
            state: first.map(|_| true),
            start,
        }
    }

    #[inline(always)]
    fn running(&self) -> bool {
        matches!(self.state, Ok(true))
    }

    /// Gyro sample before the leg, that at its end, and its time.
    #[inline(always)]
    fn span(&self) -> (usize, usize, f64) {
        let (k, reached) = (self.first + self.leg.saturating_sub(1), self.first + self.leg);
        (k, reached, if self.leg == 0 { self.start.t } else { self.log.gyro.t[reached] })
    }

    /// Time and kind of what comes next; at equal times fixes come first.
    #[inline(always)]
    fn next(&mut self) -> (f64, Event) {
        if !self.running() {
            return (self.t, Event::None);
        }
        let (_, _, end) = self.span();
        if self.start.used == Some(self.measurement) {
            self.measurement += 1;
        }
        if self.measurement < self.log.sensors.len() {
            let t = self.log.sensors.time(self.measurement);
            if t <= end {
                return (t, Event::Fix(self.measurement));
            }
        }
        (end, Event::Sample)
    }

    /// The leg has ended: writes a row if it is due, and goes on to the next leg.
    #[inline(always)]
    fn arrive(&mut self, state: impl FnOnce() -> State, covariance: impl FnOnce() -> [[f64; 6]; 6]) {
        let (_, reached, end) = self.span();
        if self.leg.is_multiple_of(self.every) {
            self.writer.row(end, reached, &state(), covariance);
        }
        self.leg += 1;
        let next = self.first + self.leg;
        let times = self.log.gyro.t;
        if next >= times.len() {
            self.state = Ok(false);
        } else if times[next].partial_cmp(&times[next - 1]) != Some(Ordering::Greater) {
            let (previous, value) = (times[next - 1], times[next]);
            self.state = Err(Error::NotIncreasing { field: "gyro.t", row: next, previous, value });
        }
    }

    fn fail(&mut self, what: &'static str, step: usize, t: f64) {
        self.state = Err(Error::NotPositiveDefinite { what, step, t });
    }
}

/// Eight numbers as lanes.
#[inline(always)]
fn pack<T: Real>(x: &[f64; LANES]) -> T {
    T::from_lanes(
        #[inline(always)]
        |i| x[i],
    )
}

/// Lanes as eight numbers each.
#[inline(always)]
fn unpacked<T: Real, const K: usize>(x: &[T; K]) -> [[f64; LANES]; K] {
    let mut out = [[0.0; LANES]; K];
    for (out, x) in out.iter_mut().zip(x) {
        for (i, out) in out.iter_mut().enumerate() {
            *out = x.lane(i);
        }
    }
    out
}

/// The filter in lanes.
struct Batch<'a, 'c, F> {
    filter: &'c F,
    model: &'a GyroModel,
    lanes: Vec<Lane<'a>>,
    poll: &'c mut dyn FnMut(usize) -> Result<()>,
}

impl<F: Filter> RunWide for Batch<'_, '_, F> {
    type Output = Result<Vec<Ended>>;

    #[inline(always)]
    fn run<T: Real<Pack = T>>(mut self) -> Self::Output {
        let mut belief = self.begin::<T>();
        let mut rounds = 0usize;
        loop {
            rounds += 1;
            if rounds.is_multiple_of(CHUNK) {
                (self.poll)(self.lanes.iter().map(|l| l.first + l.leg).sum())?;
            }
            let mut to = [0.0; LANES];
            let mut events = [Event::None; LANES];
            for (i, lane) in self.lanes.iter_mut().enumerate() {
                (to[i], events[i]) = lane.next();
            }
            if events.iter().all(|e| *e == Event::None) {
                break;
            }
            self.advance::<T>(&mut belief, &to);
            self.correct::<T>(&mut belief, &to, &events);
            self.write::<T>(&belief, &to);
        }
        Ok(self.finish::<T>(&belief))
    }
}

impl<F: Filter> Batch<'_, '_, F> {
    #[inline(always)]
    fn begin<T: Real<Pack = T>>(&mut self) -> F::Belief<AttitudeBias, T, 6> {
        let lanes = &self.lanes;
        let start = |i: usize| &lanes[if i < lanes.len() { i } else { 0 }].start;
        let mean = Attitude {
            q: std::array::from_fn(|c| T::from_lanes(|i| start(i).mean.q[c])),
            bias: std::array::from_fn(|c| T::from_lanes(|i| start(i).mean.bias[c])),
        };
        let covariance = from_fn(|r, c| T::from_lanes(|i| start(i).covariance[(r, c)]));
        let (belief, ok) = self.filter.belief::<AttitudeBias, T, 6>(mean, &covariance);
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            if !ok.lane(i) && lane.running() {
                lane.fail("initial covariance", lane.first, lane.start.t);
            }
        }
        belief
    }

    /// Moves each lane to its next event.
    #[inline(always)]
    fn advance<T: Real<Pack = T>>(&mut self, belief: &mut F::Belief<AttitudeBias, T, 6>, to: &[f64; LANES]) {
        let moves = |lane: &Lane<'_>, to: f64| lane.running() && to > lane.t;
        let (mut some, mut stays) = (false, false);
        for (lane, to) in self.lanes.iter().zip(to) {
            let moved = moves(lane, *to);
            some |= moved;
            stays |= !moved;
        }
        if !some {
            return;
        }
        let (mut t, mut dt, mut rate, mut extra) = ([0.0; LANES], [1.0; LANES], [[0.0; LANES]; 3], [0.0; LANES]);
        for (i, lane) in self.lanes.iter().enumerate() {
            if !moves(lane, to[i]) {
                continue;
            }
            let u = lane.log.gyro.between(lane.span().0);
            (t[i], dt[i], extra[i]) = (lane.t, to[i] - lane.t, u.extra);
            for c in 0..3 {
                rate[c][i] = u.rate[c];
            }
        }
        let u = GyroInput { rate: [pack(&rate[0]), pack(&rate[1]), pack(&rate[2])], extra: pack(&extra) };
        let kept = stays.then_some(*belief);
        let ok = self.filter.predict::<GyroModel, T, 6>(belief, self.model, &u, pack(&t), pack(&dt));
        if let Some(kept) = kept {
            let lanes = &self.lanes;
            belief.take(T::Mask::from_lanes(|i| i < lanes.len() && !moves(&lanes[i], to[i])), &kept);
        }
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            if moves(lane, to[i]) {
                if !ok.lane(i) {
                    lane.fail("predicted covariance", lane.span().0, to[i]);
                }
                lane.t = to[i];
            }
        }
    }

    /// Uses the fixes of the lanes that have come to one.
    #[inline(always)]
    fn correct<T: Real<Pack = T>>(
        &mut self,
        belief: &mut F::Belief<AttitudeBias, T, 6>,
        to: &[f64; LANES],
        events: &[Event; LANES],
    ) {
        let (mut q, mut noise, mut gate) = ([[0.0; LANES]; 4], [[0.0; LANES]; 6], [f64::NEG_INFINITY; LANES]);
        let mut last = None;
        for (i, lane) in self.lanes.iter().enumerate() {
            let Event::Fix(number) = events[i] else { continue };
            if !lane.running() {
                continue;
            }
            let (sensor, row) = lane.log.sensors.source(number);
            let AttitudeSensor::Star(series) = &lane.log.sensors.sensors()[sensor] else { continue };
            let fix = series.fix(row);
            for c in 0..4 {
                q[c][i] = fix.0[c];
            }
            for c in 0..6 {
                noise[c][i] = fix.1[c];
            }
            gate[i] = lane.log.sensors.gates()[2];
            last = Some(i);
        }
        let Some(last) = last else { return };
        // lanes without a fix compute on another one's, behind a gate that nothing passes
        for i in 0..LANES {
            if gate[i] < 0.0 {
                for column in q.iter_mut().chain(&mut noise) {
                    column[i] = column[last];
                }
            }
        }
        let [a, b, c, d, e, f] = &noise;
        let given: [T; 6] = [pack(a), pack(b), pack(c), pack(d), pack(e), pack(f)];
        let z: [T; 4] = [pack(&q[0]), pack(&q[1]), pack(&q[2]), pack(&q[3])];
        let gates = pack(&gate);
        let outcome = self.filter.update::<_, T, 6, 3>(belief, &StarQuaternion, &given, &z, gates);
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            let Event::Fix(number) = events[i] else { continue };
            if gate[i] < 0.0 {
                continue;
            }
            let report = Report::of_lane(&outcome, i);
            lane.measurement = number + 1;
            if report.ok {
                lane.evidence.add(&report);
                lane.writer.report(number, &report);
            } else {
                lane.fail("covariance in the update", number, to[i]);
            }
        }
    }

    /// Writes rows of the lanes that are at the end of a leg.
    #[inline(always)]
    fn write<T: Real<Pack = T>>(&mut self, belief: &F::Belief<AttitudeBias, T, 6>, to: &[f64; LANES]) {
        let (mut mean, mut variance) = (None, None);
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            // a fix at the time of a sample has been used in this round, and the sample is next
            if lane.next() != (to[i], Event::Sample) || lane.t != to[i] {
                continue;
            }
            let (mean, variance) = if lane.leg.is_multiple_of(lane.every) {
                let x = belief.mean();
                let means = [x.q[0], x.q[1], x.q[2], x.q[3], x.bias[0], x.bias[1], x.bias[2]];
                (
                    *mean.get_or_insert_with(|| unpacked(&means)),
                    *variance.get_or_insert_with(|| unpacked(&belief.variance())),
                )
            } else {
                ([[0.0; LANES]; 7], [[0.0; LANES]; 6])
            };
            let state = || State {
                q: std::array::from_fn(|c| mean[c][i]),
                bias: std::array::from_fn(|c| mean[4 + c][i]),
                variance: std::array::from_fn(|c| variance[c][i]),
            };
            lane.arrive(state, || {
                let p = belief.covariance();
                std::array::from_fn(|r| std::array::from_fn(|c| p[(r, c)].lane(i)))
            });
        }
    }

    #[inline(always)]
    fn finish<T: Real<Pack = T>>(self, belief: &F::Belief<AttitudeBias, T, 6>) -> Vec<Ended> {
        let cov = belief.covariance();
        let end = |(i, lane): (usize, Lane<'_>)| {
            lane.state?;
            Ok(End {
                t: lane.t,
                mean: AttitudeBias::map(belief.mean(), |x: T| x.lane(i)),
                covariance: from_fn(|r, c| cov[(r, c)].lane(i)),
                outside: lane.before + lane.log.sensors.len() - lane.measurement,
                log_likelihood: lane.evidence.log(),
            })
        };
        self.lanes.into_iter().enumerate().map(end).collect()
    }
}
