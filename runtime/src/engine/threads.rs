//! A fixed set of threads that run one job together, again and again.
//!
//! Created once, they meet at a barrier between the layers of a job. Who waits spins for a while, since a layer is short,
//! and then sleeps, since the other core may be busy with something else and a vehicle's computer has better uses for a
//! spinning core.

use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::{AtomicBool, AtomicUsize, Ordering::SeqCst};
use std::sync::{Arc, Condvar, Mutex, PoisonError};
use std::thread::JoinHandle;

/// Looks of a waiting thread before it sleeps: some 50 microseconds.
const SPINS: usize = 2000;

type Job<'a> = dyn Fn(&Member<'_>) + Sync + 'a;
/// Begins a thread of this name, if the system grants one.
type Begin<'a> =
    dyn FnMut(String, Box<dyn FnOnce() + Send>) -> std::io::Result<JoinHandle<()>> + 'a;

/// Keeps the calling thread on one core, from now on; false where the system refuses.
pub(super) fn stay_on(core: usize) -> bool {
    // Beyond what Linux's cpu_set_t holds core_affinity panics.
    core < 1024 && core_affinity::set_for_current(core_affinity::CoreId { id: core })
}

/// One thread's part in a job.
#[derive(Debug)]
pub(crate) struct Member<'a> {
    /// Which it is, from 0.
    pub(crate) number: usize,
    /// How many there are.
    pub(crate) members: usize,
    barrier: &'a Barrier,
}

impl Member<'_> {
    /// Waits until all members are here. False: one of them panicked, so leave the job.
    #[must_use]
    pub(crate) fn wait(&self) -> bool {
        self.barrier.wait()
    }

    /// This member's share of `length` things.
    pub(crate) fn share(&self, length: usize) -> std::ops::Range<usize> {
        length * self.number / self.members..length * (self.number + 1) / self.members
    }
}

#[derive(Debug)]
struct Barrier {
    members: usize,
    /// How often a waiting thread looks before it sleeps.
    spins: usize,
    arrived: AtomicUsize,
    round: AtomicUsize,
    sleepers: AtomicUsize,
    broken: AtomicBool,
    lock: Mutex<()>,
    wake: Condvar,
}

impl Barrier {
    fn wait(&self) -> bool {
        let round = self.round.load(SeqCst);
        if self.arrived.fetch_add(1, SeqCst) + 1 == self.members {
            self.arrived.store(0, SeqCst);
            // Not a store: QEMU lets the load of the sleepers overtake one of AArch64's, and a sleeper would sleep on.
            self.round.swap(round.wrapping_add(1), SeqCst);
            self.wake_sleepers();
        } else {
            let waiting = || self.round.load(SeqCst) == round && !self.broken.load(SeqCst);
            let mut spins = 0;
            while waiting() && spins < self.spins {
                std::hint::spin_loop();
                spins += 1;
            }
            if waiting() {
                let mut guard = self.lock.lock().unwrap_or_else(PoisonError::into_inner);
                self.sleepers.fetch_add(1, SeqCst);
                while waiting() {
                    guard = self
                        .wake
                        .wait(guard)
                        .unwrap_or_else(PoisonError::into_inner);
                }
                self.sleepers.fetch_sub(1, SeqCst);
            }
        }
        !self.broken.load(SeqCst)
    }

    fn wake_sleepers(&self) {
        // A sleeper counts itself before it looks at the round for the last time: either it sees the new round, or it
        // is seen here, and then holds the lock until it sleeps.
        if self.sleepers.load(SeqCst) > 0 {
            drop(self.lock.lock().unwrap_or_else(PoisonError::into_inner));
            self.wake.notify_all();
        }
    }

    fn break_up(&self) {
        self.broken.store(true, SeqCst);
        drop(self.lock.lock().unwrap_or_else(PoisonError::into_inner));
        self.wake.notify_all();
    }
}

#[derive(Debug)]
struct Meeting {
    barrier: Barrier,
    job: Mutex<Assignment>,
}

/// What the workers find when they pass the first barrier of a job.
#[derive(Clone, Copy)]
enum Assignment {
    Work(&'static Job<'static>),
    Leave,
}

impl std::fmt::Debug for Assignment {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(match self {
            Assignment::Work(_) => "Work",
            Assignment::Leave => "Leave",
        })
    }
}

/// The threads. The one that calls [`Team::run`] is member 0.
#[derive(Debug)]
pub(crate) struct Team {
    meeting: Arc<Meeting>,
    workers: Vec<JoinHandle<()>>,
}

impl Team {
    /// Creates `members - 1` threads; as many of them as the system grants.
    pub(crate) fn new(members: usize) -> Self {
        Self::with_spins(members, SPINS)
    }

    fn with_spins(members: usize, spins: usize) -> Self {
        Self::of_granted(members, spins, &mut |name, work| {
            std::thread::Builder::new().name(name).spawn(work)
        })
    }

    fn of_granted(members: usize, spins: usize, thread: &mut Begin<'_>) -> Self {
        let mut spawn = |members: usize| {
            let barrier = Barrier {
                members,
                spins,
                arrived: AtomicUsize::new(0),
                round: AtomicUsize::new(0),
                sleepers: AtomicUsize::new(0),
                broken: AtomicBool::new(false),
                lock: Mutex::new(()),
                wake: Condvar::new(),
            };
            let meeting = Arc::new(Meeting {
                barrier,
                job: Mutex::new(Assignment::Leave),
            });
            let mut worker = |number| {
                let meeting = meeting.clone();
                thread(
                    format!("gedepth {number}"),
                    Box::new(move || work(&meeting, number)),
                )
            };
            let workers: Vec<_> = (1..members)
                .map_while(|number| worker(number).ok())
                .collect();
            Self { meeting, workers }
        };
        let mut members = members.max(1);
        loop {
            let team = spawn(members);
            let granted = team.workers.len() + 1;
            if granted == members {
                return team;
            }
            // A system that refuses threads. Those that were created wait for more than there are: they leave, and as many begin anew.
            members = granted;
        }
    }

    /// How many there are.
    pub(crate) fn members(&self) -> usize {
        self.meeting.barrier.members
    }

    /// Runs `job` once on every member. False: a member panicked; the team is then of no further use.
    #[must_use]
    pub(crate) fn run(&mut self, job: &Job<'_>) -> bool {
        let barrier = &self.meeting.barrier;
        let member = Member {
            number: 0,
            members: self.workers.len() + 1,
            barrier,
        };
        // The workers are gone then, and this thread would do its own part alone.
        if barrier.broken.load(SeqCst) {
            return false;
        }
        if self.workers.is_empty() {
            job(&member);
            return true;
        }
        // SAFETY: only the lifetime changes. No worker touches the job after the last barrier below, or after it found
        // the barrier broken and said so by ending, and this function returns only then.
        let endless = unsafe { std::mem::transmute::<&Job<'_>, &'static Job<'static>>(job) };
        *self
            .meeting
            .job
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Assignment::Work(endless);
        let whole = barrier.wait()
            && catch_unwind(AssertUnwindSafe(|| job(&member))).is_ok()
            && barrier.wait();
        if !whole {
            self.dissolve();
        }
        whole
    }

    /// Ends the workers, wherever they wait.
    fn dissolve(&mut self) {
        self.meeting.barrier.break_up();
        for worker in self.workers.drain(..) {
            // Its panic, if that is what it was, has been reported by the barrier.
            drop(worker.join());
        }
    }
}

impl Drop for Team {
    fn drop(&mut self) {
        *self
            .meeting
            .job
            .lock()
            .unwrap_or_else(PoisonError::into_inner) = Assignment::Leave;
        self.dissolve();
    }
}

fn work(meeting: &Meeting, number: usize) {
    let barrier = &meeting.barrier;
    let member = Member {
        number,
        members: barrier.members,
        barrier,
    };
    while barrier.wait() {
        let assignment = *meeting.job.lock().unwrap_or_else(PoisonError::into_inner);
        let Assignment::Work(job) = assignment else {
            return;
        };
        if catch_unwind(AssertUnwindSafe(|| job(&member))).is_err() {
            barrier.break_up();
            return;
        }
        if !barrier.wait() {
            return;
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::atomic::AtomicU64;

    use super::*;

    /// Whoever falls asleep just as the last one comes must be woken: these sleep nearly at once, so that it happens often.
    /// Where one is missed, this hangs. A barrier that stored its round did under QEMU, after 17,000 to 44,000 jobs.
    #[test]
    fn who_falls_asleep_as_the_last_one_comes_is_woken() {
        let spins = 20;
        let members = 2;
        let (jobs, rounds) = if cfg!(target_arch = "aarch64") {
            (60_000, 8)
        } else {
            (5_000, 8)
        };
        let mut team = Team::with_spins(members, spins);
        let done = AtomicU64::new(0);
        for job in 0..jobs {
            let whole = team.run(&|member: &Member<'_>| {
                for round in 0..rounds {
                    if (job + round) % members == member.number {
                        for _ in 0..spins / 2 + (job * 37 + round * 11) % spins {
                            std::hint::spin_loop();
                        }
                    }
                    done.fetch_add(1, SeqCst);
                    assert!(member.wait());
                }
            });
            assert!(whole);
        }
        assert_eq!(done.into_inner(), (members * jobs * rounds) as u64);
    }

    /// Of a system that refuses threads, as many as it grants do the whole job.
    #[test]
    fn fewer_threads_than_asked_for_share_the_work() {
        for granted in [0, 1, 3] {
            let alive = Arc::new(AtomicUsize::new(0));
            let mut team = Team::of_granted(5, SPINS, &mut |name, work| {
                if alive.load(SeqCst) == granted {
                    return Err(std::io::ErrorKind::WouldBlock.into());
                }
                alive.fetch_add(1, SeqCst);
                let alive = alive.clone();
                std::thread::Builder::new().name(name).spawn(move || {
                    work();
                    alive.fetch_sub(1, SeqCst);
                })
            });
            assert_eq!(team.members(), granted + 1);
            let done = AtomicU64::new(0);
            assert!(team.run(&|member: &Member<'_>| {
                done.fetch_add(member.share(100).map(|i| i as u64).sum(), SeqCst);
            }));
            assert_eq!(done.into_inner(), (0..100).sum::<u64>());
        }
    }

    /// A job that panics on one thread says so on the caller's, and nobody waits for it for ever.
    #[test]
    fn a_panic_ends_the_job_for_all() {
        for number in [0, 1] {
            let mut team = Team::new(2);
            let whole = team.run(&|member: &Member<'_>| {
                assert!(member.number != number, "as this test wants");
                while member.wait() {}
            });
            assert!(!whole);
            assert!(!team.run(&|_| unreachable!("nobody is left for this")));
        }
    }
}
