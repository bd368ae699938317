//! What a run of any system finds, column by column.

use crate::belief::Belief;
use crate::manifold::Manifold;
use crate::replay::{Recorder, Report, Sink};
use crate::scalar::Real;

/// Columns over the output times and over the measurements, as rows one after the other: their widths are the sizes
/// of the state and of its error.
#[derive(Clone, Debug, Default)]
pub struct History {
    /// Whether full covariances are wanted.
    pub with_covariance: bool,
    /// Output times, s.
    pub t: Vec<f64>,
    /// States, component by component.
    pub state: Vec<f64>,
    /// Standard deviations of the error state.
    pub sigma: Vec<f64>,
    /// Covariances of the error state; nothing if they are not wanted.
    pub covariance: Vec<f64>,
    /// Numbers of the measurements in their table.
    pub row: Vec<i32>,
    /// Normalised innovation squared of each.
    pub nis: Vec<f64>,
    /// Whether it was used.
    pub accepted: Vec<bool>,
    /// Innovations.
    pub innovation: Vec<[f64; 3]>,
    /// Their standard deviations.
    pub innovation_sigma: Vec<[f64; 3]>,
}

impl History {
    #[inline(always)]
    fn state<S: Manifold<N>, T: Real, B: Belief<S, T, N>, const N: usize>(&mut self, t: f64, belief: &B) {
        self.t.push(t);
        S::map(belief.mean(), |x: T| {
            self.state.push(x.lane(0));
            x
        });
        self.sigma.extend(belief.variance().iter().map(|v| v.lane(0).sqrt()));
        if self.with_covariance {
            let p = belief.covariance();
            for i in 0..N {
                self.covariance.extend((0..N).map(|j| p[(i, j)].lane(0)));
            }
        }
    }

    /// Turns the output rows round: a smoother writes them from the end.
    fn reverse(&mut self, widths: [usize; 2]) {
        self.t.reverse();
        let [state, error] = widths;
        for (column, width) in
            [(&mut self.state, state), (&mut self.sigma, error), (&mut self.covariance, error * error)]
        {
            let rows: Vec<f64> = column.chunks_exact(width.max(1)).rev().flatten().copied().collect();
            *column = rows;
        }
    }
}

/// Where a pass over a log reports to: straight to the history, or to a recorder that a smoother reads.
pub(super) struct Pass<'a, S: Manifold<N>, const N: usize> {
    pub(super) history: &'a mut History,
    /// Which of the stops are wanted in the output.
    pub(super) wanted: &'a [bool],
    pub(super) recorder: Option<Recorder<S, N>>,
}

impl<S: Manifold<N>, const N: usize> Pass<'_, S, N> {
    /// Ends a smoother's writing.
    pub(super) fn turn_round(&mut self) {
        let rows = self.history.t.len().max(1);
        self.history.reverse([self.history.state.len() / rows, N]);
    }
}

impl<S: Manifold<N>, const N: usize> Sink<S, N> for Pass<'_, S, N> {
    #[inline(always)]
    fn state<T: Real, B: Belief<S, T, N>>(&mut self, t: f64, k: usize, belief: &B) {
        match &mut self.recorder {
            Some(recorder) if self.wanted[k] => recorder.row(t, k),
            Some(_) => {}
            None if self.wanted[k] => self.history.state(t, belief),
            None => {}
        }
    }
    #[inline(always)]
    fn measured(&mut self, i: usize, report: &Report) {
        let h = &mut *self.history;
        h.row.push(i as i32);
        h.nis.push(report.nis);
        h.accepted.push(report.accepted);
        h.innovation.push(report.innovation);
        let s = &report.covariance;
        h.innovation_sigma.push([s[0][0].sqrt(), s[1][1].sqrt(), s[2][2].sqrt()]);
    }
    #[inline(always)]
    fn leaving<T: Real, B: Belief<S, T, N>>(&mut self, t: f64, to: f64, k: usize, belief: &B) {
        if let Some(recorder) = &mut self.recorder {
            recorder.node(t, to, k, belief);
        }
    }
}
