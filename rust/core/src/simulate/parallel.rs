//! Numbered trials over threads: the same results in the same order for any number of them.

use crate::error::{Error, Result};
use std::ops::Range;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::mpsc::{Receiver, RecvTimeoutError, Sender, channel as pipe};
use std::time::Duration;

/// How often the calling thread looks up while the others work.
const POLL: Duration = Duration::from_millis(50);

/// What every thread needs to know of the work.
struct Work<'a, M, F> {
    worker: &'a M,
    trial: &'a F,
    next: AtomicU64,
    end: u64,
    stop: &'a AtomicBool,
}

/// Runs `trial` for each of the `numbers`, with a `worker` (the memory) for each thread. `poll` is called
/// on the calling thread, at least 20 times a second, with the number of trials done, and may end the
/// work: then `stop` is set, which trials look at by [`keep_on`].
///
/// # Errors
/// What `poll` returns, and the first error of a trial.
pub fn over_threads<W, R: Send>(
    numbers: Range<u64>,
    threads: usize,
    stop: &AtomicBool,
    (worker, trial): (impl Fn() -> W + Sync, impl Fn(&mut W, u64) -> Result<R> + Sync),
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<R>> {
    let trials = numbers.end.saturating_sub(numbers.start) as usize;
    let next = AtomicU64::new(numbers.start);
    let work = Work { worker: &worker, trial: &trial, next, end: numbers.end, stop };
    let (send, receive) = pipe();
    std::thread::scope(|scope| {
        for _ in 0..threads.clamp(1, trials.max(1)) {
            let (work, send) = (&work, send.clone());
            scope.spawn(move || work.run(&send));
        }
        drop(send);
        let done = collect(&receive, numbers.start, trials, poll);
        stop.store(true, Ordering::Relaxed);
        done
    })
}

/// # Errors
/// `Interrupted` once `stop` is set.
pub fn keep_on(stop: &AtomicBool) -> Result<()> {
    if stop.load(Ordering::Relaxed) { Err(Error::Interrupted) } else { Ok(()) }
}

impl<W, R, M: Fn() -> W, F: Fn(&mut W, u64) -> Result<R>> Work<'_, M, F> {
    fn run(&self, send: &Sender<(u64, Result<R>)>) {
        let mut worker = (self.worker)();
        loop {
            let number = self.next.fetch_add(1, Ordering::Relaxed);
            if number >= self.end || self.stop.load(Ordering::Relaxed) {
                return;
            }
            let result = (self.trial)(&mut worker, number);
            let failed = result.is_err();
            if send.send((number, result)).is_err() || failed {
                return;
            }
        }
    }
}

fn collect<R>(
    receive: &Receiver<(u64, Result<R>)>,
    first: u64,
    trials: usize,
    poll: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<Vec<R>> {
    let mut out: Vec<Option<R>> = (0..trials).map(|_| None).collect();
    let mut done = 0;
    while done < trials {
        match receive.recv_timeout(POLL) {
            Ok((number, result)) => {
                out[(number - first) as usize] = Some(result?);
                done += 1;
            }
            Err(RecvTimeoutError::Timeout) => {}
            // only if a thread has panicked, which the scope passes on
            Err(RecvTimeoutError::Disconnected) => return Err(Error::Interrupted),
        }
        poll(done)?;
    }
    out.into_iter().map(|result| result.ok_or(Error::Interrupted)).collect()
}
