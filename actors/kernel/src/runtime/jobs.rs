//! Background worker for a controller's long jobs: one thread per controller, started with its first job.

use std::collections::VecDeque;
use std::io;
use std::sync::mpsc::{Receiver, SyncSender, TrySendError, sync_channel};

use trocar_scene::controller::JOBS_MAX;
use trocar_scene::{Job, JobOutput, Jobs};

use super::panics::guarded;

/// Takes a controller's jobs after a tick and delivers their outputs before a later one.
pub struct JobRunner {
    name: String,
    worker: Option<Worker>,
    /// Jobs that the worker's queue has no room for yet.
    backlog: VecDeque<Job>,
}

struct Worker {
    orders: SyncSender<Job>,
    results: Receiver<(u64, Result<JobOutput, String>)>,
}

impl JobRunner {
    /// Runner for the controller `name`; the thread starts with the first job.
    pub fn new(name: &str) -> Self {
        Self { name: name.to_owned(), worker: None, backlog: VecDeque::new() }
    }

    /// Delivers finished outputs, at most as many as the controller's inbox holds, so that no output of a repeated job
    /// is dropped; the rest is delivered before the next step.
    ///
    /// # Errors
    /// The panic message of a job: its controller would otherwise wait for ever.
    pub fn deliver(&mut self, jobs: &Jobs) -> Result<(), String> {
        if let Some(worker) = &self.worker {
            for (key, result) in worker.results.try_iter().take(JOBS_MAX) {
                match result {
                    Ok(output) => jobs.deliver(key, output),
                    Err(panic) => return Err(format!("job {key}: {panic}")),
                }
            }
        }
        Ok(())
    }

    /// Takes the submitted jobs.
    ///
    /// # Errors
    /// When no thread can be started.
    pub fn collect(&mut self, jobs: &Jobs) -> io::Result<()> {
        while self.backlog.len() < JOBS_MAX
            && let Some(job) = jobs.next_submitted()
        {
            self.backlog.push_back(job);
        }
        while let Some(job) = self.backlog.pop_front() {
            let worker = match &mut self.worker {
                Some(worker) => worker,
                none => none.insert(Worker::start(&self.name)?),
            };
            match worker.orders.try_send(job) {
                Ok(()) => {}
                Err(TrySendError::Full(job) | TrySendError::Disconnected(job)) => {
                    self.backlog.push_front(job);
                    break;
                }
            }
        }
        Ok(())
    }
}

impl Worker {
    /// Starts the worker thread. It ends when the runner is dropped and the running job is done; it is never joined, as
    /// that may take long.
    fn start(name: &str) -> io::Result<Self> {
        let (orders, inbox) = sync_channel::<Job>(JOBS_MAX);
        let (outbox, results) = sync_channel(JOBS_MAX);
        std::thread::Builder::new().name(format!("job {name}")).spawn(move || {
            for Job { key, work, .. } in inbox {
                if outbox.send((key, guarded(work))).is_err() {
                    break;
                }
            }
        })?;
        Ok(Self { orders, results })
    }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use trocar_scene::SimTime;

    use super::*;

    fn wait_for(runner: &mut JobRunner, jobs: &Jobs, key: u64) -> Result<JobOutput, String> {
        let begun = Instant::now();
        loop {
            runner.deliver(jobs)?;
            if let Some(output) = jobs.take(key) {
                return Ok(output);
            }
            assert!(begun.elapsed() < Duration::from_secs(10), "job {key} never came back");
            runner.collect(jobs).expect("a thread");
            std::thread::sleep(Duration::from_millis(1));
        }
    }

    #[test]
    fn outputs_come_back_under_their_keys_beyond_the_room_of_the_worker() {
        let (jobs, mut runner) = (Jobs::default(), JobRunner::new("toy"));
        let mut next = 0_u64;
        for wave in 0..4_u64 {
            while jobs.submit(Job {
                key: next,
                takes: SimTime::ZERO,
                work: Box::new(move || Box::new(next * 2)),
            }) {
                next += 1;
            }
            runner.collect(&jobs).expect("a thread");
            for key in wave * JOBS_MAX as u64..next {
                let output = wait_for(&mut runner, &jobs, key).expect("no panic");
                assert_eq!(output.downcast_ref::<u64>(), Some(&(key * 2)));
            }
        }
    }

    #[test]
    fn no_output_is_forgotten_by_who_asks_in_each_step_however_many_come_between_two() {
        let (jobs, mut runner) = (Jobs::default(), JobRunner::new("toy"));
        let all = 3 * JOBS_MAX as u64;
        for key in 0..all {
            assert!(jobs.submit(Job { key, takes: SimTime::ZERO, work: Box::new(move || Box::new(key)) }));
            runner.collect(&jobs).expect("a thread");
        }
        let mut left: Vec<u64> = (0..all).collect();
        let begun = Instant::now();
        while !left.is_empty() {
            // A slow controller: before its next step more jobs finish than its inbox holds.
            std::thread::sleep(Duration::from_millis(50));
            runner.deliver(&jobs).expect("no panic");
            left.retain(|key| jobs.take(*key).is_none());
            runner.collect(&jobs).expect("a thread");
            assert!(begun.elapsed() < Duration::from_secs(10), "{left:?} never came back");
        }
    }

    #[test]
    fn a_job_that_panics_is_told() {
        let (jobs, mut runner) = (Jobs::default(), JobRunner::new("toy"));
        assert!(jobs.submit(Job {
            key: 5,
            takes: SimTime::ZERO,
            work: Box::new(|| panic!("singular matrix"))
        }));
        let error = wait_for(&mut runner, &jobs, 5).expect_err("the panic");
        assert!(error.contains("job 5") && error.contains("singular matrix"), "{error}");
    }
}
