//! Does the newest thing asked of it: in a thread, or in a page when it is looked at.

#[cfg(target_family = "wasm")]
pub use page::Worker;
#[cfg(not(target_family = "wasm"))]
pub use thread::Worker;

#[cfg(target_family = "wasm")]
mod page {
    use std::cell::RefCell;

    /// Takes tasks, and forgets those that are replaced before they are done.
    pub struct Worker<T, R> {
        task: RefCell<Option<T>>,
        work: RefCell<Box<dyn FnMut(T) -> R>>,
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
                task: RefCell::default(),
                work: RefCell::new(Box::new(work)),
                wake: Box::new(wake),
            }
        }

        /// Asks for this in place of what has not begun.
        pub fn ask(&self, task: T) {
            *self.task.borrow_mut() = Some(task);
            (self.wake)();
        }

        /// Does the newest task since it was asked last.
        pub fn newest(&self) -> Option<R> {
            let task = self.task.borrow_mut().take()?;
            Some((self.work.borrow_mut())(task))
        }
    }
}

#[cfg(not(target_family = "wasm"))]
mod thread {
    use std::sync::{Arc, Condvar, Mutex, PoisonError, mpsc};
    use std::thread::JoinHandle;

    struct Slot<T> {
        task: Option<T>,
        ended: bool,
    }

    /// Takes tasks, forgets those that are replaced before they begin, and returns results.
    pub struct Worker<T, R> {
        slot: Arc<(Mutex<Slot<T>>, Condvar)>,
        results: mpsc::Receiver<R>,
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
                while let Some(task) = next(&inbox) {
                    // Nobody listens any more while the application ends.
                    let _ = sender.send(work(task));
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
                thread,
            }
        }

        /// Asks for this in place of what has not begun.
        pub fn ask(&self, task: T) {
            let (slot, posted) = &*self.slot;
            slot.lock().unwrap_or_else(PoisonError::into_inner).task = Some(task);
            posted.notify_one();
        }

        /// The newest result since it was asked last.
        pub fn newest(&self) -> Option<R> {
            self.results.try_iter().last()
        }
    }

    fn next<T>((slot, posted): &(Mutex<Slot<T>>, Condvar)) -> Option<T> {
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
