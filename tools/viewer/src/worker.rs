//! A thread that does the newest thing asked of it.

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
