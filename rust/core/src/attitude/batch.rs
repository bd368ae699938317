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
use crate::belief::{Belief, Outcome};
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

/// Whether a filter runs in lanes over such a log. Other filters, direction sensors, more than a gate for
/// doubtful fixes, output at a period of its own and levels without lanes run one log at a time.
pub fn in_lanes(filter: &AnyFilter, log: &Log<'_>, options: &Options) -> bool {
    let known = matches!(filter, AnyFilter::Ekf(_) | AnyFilter::Ukf(_));
    let stars = log.sensors.sensors().iter().all(|s| matches!(s, AttitudeSensor::Star(_)));
    let plain = log.sensors.trust().is_plain();
    options.level.has_lanes() && known && stars && plain && matches!(options.output, Output::Every(n) if n > 0)
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

/// One log on its way.
struct Lane<'a> {
    writer: Writer<'a, GyroModel>,
    log: Log<'a>,
    start: Start<AttitudeBias, 6>,
    every: usize,
    /// Legs until the next row.
    wait: usize,
    first: usize,
    leg: usize,
    measurement: usize,
    /// Sensor and row of the next fix.
    source: (usize, usize),
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
            wait: 0,
            leg: 0,
            measurement: before,
            source: (0, 0),
            before,
            evidence: Evidence::default(),
            first: *first.as_ref().unwrap_or(&0),
            state: first.map(|_| true),
            start,
        }
    }

    /// Gyro sample before the leg, and that at its end.
    #[inline(always)]
    fn span(&self) -> (usize, usize) {
        (self.first + self.leg.saturating_sub(1), self.first + self.leg)
    }

    /// Time of the next fix, one that the start has used left out; not a number after the last one.
    #[inline(always)]
    fn next_fix(&mut self) -> f64 {
        if self.start.used == Some(self.measurement) {
            self.measurement += 1;
        }
        let sensors = self.log.sensors;
        if self.measurement >= sensors.len() {
            return f64::NAN;
        }
        self.source = sensors.source(self.measurement);
        sensors.sensors()[self.source.0].times()[self.source.1]
    }

    fn fail(&mut self, what: &'static str, step: usize, t: f64) {
        self.state = Err(Error::NotPositiveDefinite { what, step, t });
    }
}

/// Where the lanes are and where they go next, side by side: what is asked for in every round.
struct Course {
    /// Time.
    t: [f64; LANES],
    /// Time of the next fix, not a number where there is none.
    fix: [f64; LANES],
    /// End of the leg, at a gyro sample; not a number where the lane stands still.
    end: [f64; LANES],
    /// Measured rate in the leg, and noise beyond that of the gyro.
    rate: [[f64; LANES]; 3],
    extra: [f64; LANES],
    /// Lanes that do not stand still.
    running: usize,
}

impl Course {
    fn new() -> Self {
        let nothing = [0.0; LANES];
        Self {
            t: nothing,
            fix: [f64::NAN; LANES],
            end: [f64::NAN; LANES],
            rate: [nothing; 3],
            extra: nothing,
            running: 0,
        }
    }

    /// Takes up the leg of a lane.
    #[inline(always)]
    fn depart(&mut self, i: usize, lane: &Lane<'_>) {
        let (before, reached) = lane.span();
        self.end[i] = if lane.leg == 0 { lane.start.t } else { lane.log.gyro.t[reached] };
        let u = lane.log.gyro.between(before);
        for c in 0..3 {
            self.rate[c][i] = u.rate[c];
        }
        self.extra[i] = u.extra;
    }

    /// A lane stands still from now on.
    fn stop(&mut self, i: usize) {
        self.end[i] = f64::NAN;
        self.running -= 1;
    }

    /// Time and kind of what comes next in a lane; at equal times fixes come first.
    #[inline(always)]
    fn next(&self, i: usize) -> (f64, bool) {
        let fix = self.fix[i] <= self.end[i];
        (if fix { self.fix[i] } else { self.end[i] }, fix)
    }
}

/// The fixes of a round, side by side. Lanes that have none hold whatever they held before.
struct Fixes {
    q: [[f64; LANES]; 4],
    noise: [[f64; LANES]; 6],
    /// Minus infinity in lanes without a fix.
    gate: [f64; LANES],
}

/// What an update reports, as numbers lane by lane: what lies in registers is taken apart once, not once a lane.
struct Reports {
    ok: [bool; LANES],
    accepted: [bool; LANES],
    /// Normalised innovation squared, innovation, the lower triangle of its covariance and the determinant of that.
    numbers: [[f64; LANES]; 11],
}

impl Reports {
    #[inline(always)]
    fn new<T: Real>(o: &Outcome<T, 3>) -> Self {
        let (e, s) = (&o.innovation, &o.covariance);
        let lower = [s[(0, 0)], s[(1, 0)], s[(1, 1)], s[(2, 0)], s[(2, 1)], s[(2, 2)]];
        let [a, b, c, d, f, g] = lower;
        let minors = [c * g - f * f, d * f - b * g, b * f - c * d];
        let determinant = a.mul_add(minors[0], b.mul_add(minors[1], d * minors[2]));
        let mut new = Self {
            ok: [false; LANES],
            accepted: [false; LANES],
            numbers: unpacked(&[o.nis, e[0], e[1], e[2], a, b, c, d, f, g, determinant]),
        };
        for i in 0..LANES {
            new.ok[i] = o.ok.lane(i);
            new.accepted[i] = o.accepted.lane(i);
        }
        new
    }

    #[inline(always)]
    fn lane(&self, i: usize) -> Report {
        let [nis, x, y, z, xx, yx, yy, zx, zy, zz, _] = &self.numbers;
        Report {
            ok: self.ok[i],
            accepted: self.accepted[i],
            dof: 3,
            nis: nis[i],
            innovation: [x[i], y[i], z[i]],
            covariance: [[xx[i], yx[i], zx[i]], [yx[i], yy[i], zy[i]], [zx[i], zy[i], zz[i]]],
            rows: [1, usize::from(self.accepted[i])],
        }
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
        let mut course = Course::new();
        let mut belief = self.begin::<T>(&mut course);
        // on the heap, and there once for all: it is rarely needed, and large
        let mut kept = Box::new(belief);
        let nothing = [0.0; LANES];
        let mut fixes = Fixes { q: [nothing; 4], noise: [nothing; 6], gate: nothing };
        let mut rounds = 0usize;
        while course.running > 0 {
            rounds += 1;
            if rounds.is_multiple_of(CHUNK) {
                (self.poll)(self.lanes.iter().map(|l| l.first + l.leg).sum())?;
            }
            // fixes are collected before the prediction: what is written as numbers and read as lanes takes a while
            let count = self.gather(&mut fixes, &course);
            self.advance::<T>(&mut belief, &mut kept, &mut course);
            if count > 0 {
                self.correct::<T>(&mut belief, &fixes, &mut course);
            }
            self.write::<T>(&belief, &mut course);
        }
        Ok(self.finish::<T>(&belief, &course))
    }
}

impl<F: Filter> Batch<'_, '_, F> {
    #[inline(always)]
    fn begin<T: Real<Pack = T>>(&mut self, course: &mut Course) -> F::Belief<AttitudeBias, T, 6> {
        let lanes = &self.lanes;
        let start = |i: usize| &lanes[if i < lanes.len() { i } else { 0 }].start;
        let mean = Attitude {
            q: std::array::from_fn(|c| T::from_lanes(|i| start(i).mean.q[c])),
            bias: std::array::from_fn(|c| T::from_lanes(|i| start(i).mean.bias[c])),
        };
        let covariance = from_fn(|r, c| T::from_lanes(|i| start(i).covariance[(r, c)]));
        let (belief, ok) = self.filter.belief::<AttitudeBias, T, 6>(mean, &covariance);
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            course.t[i] = lane.start.t;
            if lane.state.is_err() {
                continue;
            }
            if ok.lane(i) {
                course.running += 1;
                course.depart(i, lane);
                course.fix[i] = lane.next_fix();
            } else {
                lane.fail("initial covariance", lane.first, lane.start.t);
            }
        }
        belief
    }

    /// Moves each lane to its next event.
    #[inline(always)]
    fn advance<T: Real<Pack = T>>(
        &mut self,
        belief: &mut F::Belief<AttitudeBias, T, 6>,
        kept: &mut F::Belief<AttitudeBias, T, 6>,
        course: &mut Course,
    ) {
        let (mut to, mut dt) = (course.t, [1.0; LANES]);
        let (mut moved, mut stays) = ([false; LANES], false);
        for i in 0..LANES {
            let (next, _) = course.next(i);
            if next > course.t[i] {
                (to[i], dt[i], moved[i]) = (next, next - course.t[i], true);
            } else {
                // slots that no log has are nobody's
                stays |= i < self.lanes.len();
            }
        }
        if to == course.t {
            return;
        }
        let rate = [pack(&course.rate[0]), pack(&course.rate[1]), pack(&course.rate[2])];
        let u = GyroInput { rate, extra: pack(&course.extra) };
        if stays {
            *kept = *belief;
        }
        let ok = self.filter.predict::<GyroModel, T, 6>(belief, self.model, &u, pack(&course.t), pack(&dt));
        if stays {
            let own = self.lanes.len();
            belief.take(
                T::Mask::from_lanes(
                    #[inline(always)]
                    |i| i < own && !moved[i],
                ),
                kept,
            );
        }
        course.t = to;
        if !ok.all() {
            for (i, lane) in self.lanes.iter_mut().enumerate() {
                if moved[i] && !ok.lane(i) {
                    lane.fail("predicted covariance", lane.span().0, to[i]);
                    course.stop(i);
                }
            }
        }
    }

    /// Uses the fixes that lanes have come to.
    #[inline(always)]
    fn correct<T: Real<Pack = T>>(
        &mut self,
        belief: &mut F::Belief<AttitudeBias, T, 6>,
        fixes: &Fixes,
        course: &mut Course,
    ) {
        let [a, b, c, d, e, f] = &fixes.noise;
        let given: [T; 6] = [pack(a), pack(b), pack(c), pack(d), pack(e), pack(f)];
        let z: [T; 4] = [pack(&fixes.q[0]), pack(&fixes.q[1]), pack(&fixes.q[2]), pack(&fixes.q[3])];
        let gates = pack(&fixes.gate);
        let outcome = self.filter.update::<_, T, 6, 3>(belief, &StarQuaternion, &given, &z, gates);
        let reports = Reports::new(&outcome);
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            // no fix, or a prediction that has failed
            if fixes.gate[i] < 0.0 || course.end[i].is_nan() {
                continue;
            }
            let report = reports.lane(i);
            let number = lane.measurement;
            if report.ok {
                if report.accepted {
                    lane.evidence.add_accepted(&report, reports.numbers[10][i]);
                }
                lane.writer.report(lane.source, &report);
            } else {
                lane.fail("covariance in the update", number, course.t[i]);
                course.stop(i);
            }
            lane.measurement += 1;
            course.fix[i] = lane.next_fix();
        }
    }

    /// Collects the fixes that lanes come to, and counts them.
    #[inline(always)]
    fn gather(&self, fixes: &mut Fixes, course: &Course) -> usize {
        let (mut count, mut last) = (0, 0);
        fixes.gate = [f64::NEG_INFINITY; LANES];
        for (i, lane) in self.lanes.iter().enumerate() {
            if !course.next(i).1 {
                continue;
            }
            let (sensors, (sensor, row)) = (lane.log.sensors, lane.source);
            let AttitudeSensor::Star(series) = &sensors.sensors()[sensor] else { continue };
            let (q, noise) = series.fix(row);
            for c in 0..4 {
                fixes.q[c][i] = q[c];
            }
            for c in 0..6 {
                fixes.noise[c][i] = noise[c];
            }
            fixes.gate[i] = sensors.trust().gates()[2];
            (count, last) = (count + 1, i);
        }
        // lanes without a fix compute on another one's, behind a gate that nothing passes
        if count > 0 && count < LANES {
            for i in 0..LANES {
                if fixes.gate[i] < 0.0 {
                    for column in fixes.q.iter_mut().chain(&mut fixes.noise) {
                        column[i] = column[last];
                    }
                }
            }
        }
        count
    }

    /// The lanes that are at the end of a leg write a row if it is due, and go on to the next leg.
    #[inline(always)]
    fn write<T: Real<Pack = T>>(&mut self, belief: &F::Belief<AttitudeBias, T, 6>, course: &mut Course) {
        let mut written = None;
        for (i, lane) in self.lanes.iter_mut().enumerate() {
            // a fix at the time of a sample has been used in this round, and the sample is next
            if course.next(i) != (course.t[i], false) {
                continue;
            }
            if lane.wait == 0 {
                lane.wait = lane.every;
                let numbers = written.get_or_insert_with(
                    #[inline(always)]
                    || {
                        let (x, v) = (belief.mean(), belief.variance());
                        let [a, b, c, d] = x.q;
                        let [e, f, g] = x.bias;
                        unpacked(&[a, b, c, d, e, f, g, v[0], v[1], v[2], v[3], v[4], v[5]])
                    },
                );
                let at = |k: usize| numbers[k][i];
                let state = State {
                    q: [at(0), at(1), at(2), at(3)],
                    bias: [at(4), at(5), at(6)],
                    variance: [at(7), at(8), at(9), at(10), at(11), at(12)],
                };
                lane.writer.row(course.t[i], lane.first + lane.leg, &state, || {
                    let p = belief.covariance();
                    std::array::from_fn(|r| std::array::from_fn(|c| p[(r, c)].lane(i)))
                });
            }
            lane.wait -= 1;
            lane.leg += 1;
            let next = lane.first + lane.leg;
            let times = lane.log.gyro.t;
            if next >= times.len() {
                lane.state = Ok(false);
                course.stop(i);
            } else if times[next].partial_cmp(&times[next - 1]) == Some(Ordering::Greater) {
                course.depart(i, lane);
            } else {
                let (previous, value) = (times[next - 1], times[next]);
                lane.state = Err(Error::NotIncreasing { field: "gyro.t", row: next, previous, value });
                course.stop(i);
            }
        }
    }

    #[inline(always)]
    fn finish<T: Real<Pack = T>>(self, belief: &F::Belief<AttitudeBias, T, 6>, course: &Course) -> Vec<Ended> {
        let cov = belief.covariance();
        let end = |(i, lane): (usize, Lane<'_>)| {
            lane.state?;
            Ok(End {
                t: course.t[i],
                mean: AttitudeBias::map(belief.mean(), |x: T| x.lane(i)),
                covariance: from_fn(|r, c| cov[(r, c)].lane(i)),
                outside: lane.before + lane.log.sensors.len() - lane.measurement,
                log_likelihood: lane.evidence.log(),
            })
        };
        self.lanes.into_iter().enumerate().map(end).collect()
    }
}
