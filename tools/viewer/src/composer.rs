//! Does the newest thing asked of it: in a thread, or in a page when it is looked at.

#[cfg(target_family = "wasm")]
pub use page::Worker;
#[cfg(not(target_family = "wasm"))]
pub use thread::Worker;

#[cfg(target_family = "wasm")]
mod page {
    /// Takes tasks, and forgets those that are replaced before they are done.
    pub struct Worker<T, R> {
        task: Option<T>,
        work: Box<dyn FnMut(T) -> R>,
        wake: Box<dyn Fn()>,
    }

    impl<T, R> Worker<T, R> {
        /// `wake` is called after every task that is asked for.
        pub fn new(
            _name: &str,
            work: impl FnMut(T) -> R + 'static,
            wake: impl Fn() + 'static,
        ) -> Self {
            Self {
                task: None,
                work: Box::new(work),
                wake: Box::new(wake),
            }
        }

        /// Asks for this in place of what has not begun.
        pub fn ask(&mut self, task: T) {
            self.task = Some(task);
            (self.wake)();
        }

        /// Does the newest task since it was asked last.
        pub fn newest(&mut self) -> Option<R> {
            let task = self.task.take()?;
            Some((self.work)(task))
        }

        /// Whether what was asked for last is still to come.
        pub fn is_busy(&self) -> bool {
            self.task.is_some()
        }
    }
}

#[cfg(not(target_family = "wasm"))]
mod thread {
    use std::sync::{Arc, Condvar, Mutex, PoisonError, mpsc};
    use std::thread::JoinHandle;

    struct Slot<T> {
        /// With its number.
        task: Option<(u64, T)>,
        ended: bool,
    }

    /// Takes tasks, forgets those that are replaced before they begin, and returns results.
    pub struct Worker<T, R> {
        slot: Arc<(Mutex<Slot<T>>, Condvar)>,
        results: mpsc::Receiver<(u64, R)>,
        /// Tasks so far, and the number of the one whose result came last.
        asked: u64,
        answered: u64,
        thread: Option<JoinHandle<()>>,
    }

    impl<T: Send + 'static, R: Send + 'static> Worker<T, R> {
        /// Starts the thread; `wake` is called after every result.
        pub fn new(
            name: &str,
            mut work: impl FnMut(T) -> R + Send + 'static,
            wake: impl Fn() + Send + 'static,
        ) -> Self {
            let slot = Arc::new((
                Mutex::new(Slot {
                    task: None,
                    ended: false,
                }),
                Condvar::new(),
            ));
            let (sender, results) = mpsc::channel();
            let inbox = slot.clone();
            let run = move || {
                while let Some((number, task)) = next(&inbox) {
                    // Nobody listens any more while the application ends.
                    let _ = sender.send((number, work(task)));
                    wake();
                }
            };
            let thread = std::thread::Builder::new()
                .name(name.into())
                .spawn(run)
                .ok();
            Self {
                slot,
                results,
                asked: 0,
                answered: 0,
                thread,
            }
        }

        /// Asks for this in place of what has not begun.
        pub fn ask(&mut self, task: T) {
            self.asked += 1;
            let (slot, posted) = &*self.slot;
            let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
            slot.task = Some((self.asked, task));
            posted.notify_one();
        }

        /// The newest result since it was asked last.
        pub fn newest(&mut self) -> Option<R> {
            let (number, result) = self.results.try_iter().last()?;
            self.answered = number;
            Some(result)
        }

        /// Whether what was asked for last is still to come: a result may be of what was begun before.
        pub fn is_busy(&self) -> bool {
            self.answered != self.asked
        }
    }

    fn next<T>((slot, posted): &(Mutex<Slot<T>>, Condvar)) -> Option<(u64, T)> {
        let mut slot = slot.lock().unwrap_or_else(PoisonError::into_inner);
        loop {
            if slot.ended {
                return None;
            }
            if let Some(task) = slot.task.take() {
                return Some(task);
            }
            slot = posted.wait(slot).unwrap_or_else(PoisonError::into_inner);
        }
    }

    impl<T, R> Drop for Worker<T, R> {
        fn drop(&mut self) {
            let (slot, posted) = &*self.slot;
            slot.lock().unwrap_or_else(PoisonError::into_inner).ended = true;
            posted.notify_one();
            if let Some(thread) = self.thread.take() {
                // What it panicked of was told when it did.
                let _ = thread.join();
            }
        }
    }
}

#[cfg(all(test, not(target_family = "wasm")))]
mod tests {
    use std::sync::mpsc;

    use super::Worker;

    #[test]
    fn results_of_what_was_begun_before_leave_it_busy() {
        let (begun, has_begun) = mpsc::channel();
        let (go, may_end) = mpsc::channel();
        let (woken, has_ended) = mpsc::channel();
        let work = move |task: u32| {
            begun.send(task).expect("a listener");
            may_end.recv().expect("a sender");
            task
        };
        let mut worker = Worker::new("test", work, move || {
            // The last one comes when nobody listens.
            let _ = woken.send(());
        });
        assert!(!worker.is_busy());
        worker.ask(1);
        assert_eq!(has_begun.recv(), Ok(1));
        // Never begun.
        worker.ask(2);
        worker.ask(3);
        go.send(()).expect("a worker");
        has_ended.recv().expect("a result");
        assert_eq!(worker.newest(), Some(1));
        assert!(worker.is_busy(), "the third is still to come");
        go.send(()).expect("a worker");
        has_ended.recv().expect("a result");
        assert_eq!(worker.newest(), Some(3));
        assert!(!worker.is_busy());
        assert_eq!(worker.newest(), None);
    }
}
