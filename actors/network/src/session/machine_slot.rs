//! Machine slot: where a machine waits between two lives of the actor that carries it.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

/// Holds one machine, or none; clones share it.
pub struct MachineSlot<T>(Arc<Mutex<Option<T>>>);

impl<T> Clone for MachineSlot<T> {
    fn clone(&self) -> Self {
        Self(self.0.clone())
    }
}

impl<T> MachineSlot<T> {
    /// A slot with a machine in it.
    pub fn new(machine: T) -> Self {
        Self(Arc::new(Mutex::new(Some(machine))))
    }

    fn lock(&self) -> MutexGuard<'_, Option<T>> {
        // Whoever panicked while it held the lock only moved a machine in or out.
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes the machine out, to be put back when it is dropped; `None` if there is none.
    pub fn take(&self) -> Option<HeldMachine<T>> {
        let machine = self.lock().take()?;
        Some(HeldMachine { machine: Some(machine), slot: self.clone() })
    }

    /// Takes the machine out, or takes one that is made now if it was lost.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn take_or_make<E>(&self, make: impl FnOnce() -> Result<T, E>) -> Result<HeldMachine<T>, E> {
        match self.take() {
            Some(held) => Ok(held),
            None => Ok(HeldMachine { machine: Some(make()?), slot: self.clone() }),
        }
    }

    /// Puts a machine in, in place of one that is there.
    pub fn put(&self, machine: T) {
        *self.lock() = Some(machine);
    }
}

/// A machine out of its slot. It goes back when it is dropped, unless [`Self::work`] was under way: then it is lost.
pub struct HeldMachine<T> {
    machine: Option<T>,
    slot: MachineSlot<T>,
}

impl<T> HeldMachine<T> {
    /// Works with the machine. If the work panics, the machine is dropped with it.
    ///
    /// # Panics
    /// When an earlier call panicked and somebody caught that.
    pub fn work<R>(&mut self, work: impl FnOnce(&mut T) -> R) -> R {
        let mut machine = self.machine.take().expect("a machine whose work panicked is not used again");
        let result = work(&mut machine);
        self.machine = Some(machine);
        result
    }
}

impl<T> Drop for HeldMachine<T> {
    fn drop(&mut self) {
        if let Some(machine) = self.machine.take() {
            self.slot.put(machine);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;

    #[test]
    fn a_life_that_ends_hands_the_machine_on_and_one_that_dies_at_work_loses_it() {
        let slot = MachineSlot::new(vec![1]);
        let mut held = slot.take().expect("it is there");
        assert!(slot.take().is_none(), "one life at a time");
        held.work(|machine| machine.push(2));
        drop(held);
        let mut held = slot.take().expect("it came back");
        assert_eq!(held.work(|machine| machine.len()), 2);
        let died = catch_unwind(AssertUnwindSafe(|| held.work(|_| panic!("within"))));
        assert!(died.is_err());
        drop(held);
        assert!(slot.take().is_none());
        let mut made = slot.take_or_make(|| Ok::<_, ()>(vec![7])).expect("it is made anew");
        assert_eq!(made.work(|machine| machine.len()), 1);
        drop(made);
        let kept = slot.take_or_make(|| Err(())).expect("it is there").work(|machine| machine.clone());
        assert_eq!(kept, [7]);
    }
}
