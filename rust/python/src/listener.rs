//! How Python hears of a computation that runs without it.

use celestcore_core::Error;
use pyo3::prelude::*;
use std::time::{Duration, Instant};

/// Often enough for Ctrl-C, seldom enough not to wait for other threads.
const POLL: Duration = Duration::from_millis(50);

/// Lets Python handle Ctrl-C and hear of the progress.
pub(crate) struct Listener {
    progress: Option<Py<PyAny>>,
    total: usize,
    heard: Instant,
    stopped: Option<PyErr>,
}

impl Listener {
    pub(crate) fn new(progress: Option<Py<PyAny>>, total: usize) -> Self {
        Self { progress, total, heard: Instant::now(), stopped: None }
    }

    /// Tells how much is done; an error ends the computation.
    pub(crate) fn poll(&mut self, done: usize) -> celestcore_core::Result<()> {
        if self.heard.elapsed() < POLL && done < self.total {
            return Ok(());
        }
        self.heard = Instant::now();
        let heard = Python::attach(|py| {
            py.check_signals()?;
            match &self.progress {
                Some(call) => call.call1(py, (done, self.total)).map(|_| ()),
                None => Ok(()),
            }
        });
        heard.map_err(|error| {
            self.stopped = Some(error);
            Error::Interrupted
        })
    }

    /// What ended the computation, if Python did.
    pub(crate) fn finish(self) -> PyResult<()> {
        self.stopped.map_or(Ok(()), Err)
    }
}
