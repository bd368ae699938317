//! Several sensors in one order of time, without a table of it that grows by eight bytes a measurement.

use crate::error::{Error, Result};

/// Measurements between two that are known by all sensors' rows.
const BLOCK: usize = 32;

/// Which measurement comes from which row of which sensor.
#[derive(Clone, Debug)]
pub(super) enum Order {
    /// All of one sensor: its number and its rows.
    One(usize, usize),
    /// Several sensors.
    Several(Merged),
}

/// The sensor of each measurement, and every few of them how many each sensor has had: a row is found by
/// counting from there.
#[derive(Clone, Debug)]
pub(super) struct Merged {
    sensor: Vec<u8>,
    rows: Vec<u32>,
    count: usize,
}

impl Order {
    /// Merges the times of sensors, each in order; `None` is left out. At equal times they come in the order
    /// given.
    pub(super) fn new(times: &[Option<&[f64]>]) -> Result<Self> {
        let seen: Vec<usize> = (0..times.len()).filter(|s| times[*s].is_some_and(|t| !t.is_empty())).collect();
        match seen[..] {
            [] => Ok(Self::One(0, 0)),
            [sensor] => Ok(Self::One(sensor, times[sensor].map_or(0, <[f64]>::len))),
            _ if times.len() > 256 => {
                let value = times.len() as f64;
                Err(Error::Parameter { field: "sensors", value, need: "must be at most 256" })
            }
            _ => Ok(Self::Several(Merged::new(times))),
        }
    }

    #[inline(always)]
    pub(super) fn len(&self) -> usize {
        match self {
            Self::One(_, rows) => *rows,
            Self::Several(merged) => merged.sensor.len(),
        }
    }

    /// Sensor and row of measurement `i`.
    #[inline(always)]
    pub(super) fn source(&self, i: usize) -> (usize, usize) {
        match self {
            Self::One(sensor, _) => (*sensor, i),
            Self::Several(merged) => merged.source(i),
        }
    }
}

impl Merged {
    fn new(times: &[Option<&[f64]>]) -> Self {
        let count = times.len();
        let all: usize = times.iter().flatten().map(|t| t.len()).sum();
        let mut merged =
            Self { sensor: Vec::with_capacity(all), rows: Vec::with_capacity(all.div_ceil(BLOCK) * count), count };
        let mut next = vec![0_u32; count];
        let head = |s: usize, row: u32| times[s].and_then(|t| t.get(row as usize)).copied();
        let mut heads: Vec<f64> = (0..count).map(|s| head(s, 0).unwrap_or(f64::INFINITY)).collect();
        for i in 0..all {
            if i % BLOCK == 0 {
                merged.rows.extend_from_slice(&next);
            }
            // the first of the earliest; a time that is infinite comes before an end
            let mut first = 0;
            for s in 1..count {
                let ended = |s: usize| head(s, next[s]).is_none();
                if heads[s] < heads[first] || ended(first) && !ended(s) {
                    first = s;
                }
            }
            merged.sensor.push(first as u8);
            next[first] += 1;
            heads[first] = head(first, next[first]).unwrap_or(f64::INFINITY);
        }
        merged
    }

    #[inline(always)]
    fn source(&self, i: usize) -> (usize, usize) {
        let (sensor, block) = (self.sensor[i], i / BLOCK);
        let before = self.sensor[block * BLOCK..i].iter().filter(|s| **s == sensor).count();
        let sensor = usize::from(sensor);
        (sensor, self.rows[block * self.count + sensor] as usize + before)
    }
}
