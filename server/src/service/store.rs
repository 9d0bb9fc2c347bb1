//! The snapshots of a session, and the memory that all snapshots of a server may take.

use std::collections::BTreeMap;
use std::sync::Arc;
use std::sync::atomic::{AtomicU64, Ordering};

use trocar_proto::snapshot::Recipe;
use trocar_proto::{Code, Placement, Rejection};

use super::shared_world::SavedWorld;
use crate::env::{Env, Identity};

/// Memory that sessions and snapshots share, bytes: those of a server, or of one of its clients.
#[derive(Debug)]
pub(super) struct Ledger {
    budget: u64,
    /// The option of `trocar serve` that sets it.
    option: &'static str,
    /// The server's, where this is a client's.
    whole: Option<Arc<Self>>,
    /// What open sessions are counted with.
    sessions: AtomicU64,
    /// What their snapshots are counted with.
    snapshots: AtomicU64,
    /// Numbers that were given to snapshots: no two of a server have the same.
    numbers: AtomicU64,
}

impl Ledger {
    pub(super) fn new(budget: u64) -> Self {
        let zero = || AtomicU64::new(0);
        let option = "--memory";
        Self { budget, option, whole: None, sessions: zero(), snapshots: zero(), numbers: zero() }
    }

    /// That of a client of this server.
    pub(super) fn of_client(self: &Arc<Self>, budget: u64) -> Self {
        Self { option: "--client-memory", whole: Some(Arc::clone(self)), ..Self::new(budget) }
    }

    /// Takes note of what sessions are counted with.
    pub(super) fn set_sessions(&self, bytes: u64) {
        self.sessions.store(bytes, Ordering::Relaxed);
    }

    /// What snapshots are counted with.
    pub(super) fn snapshots(&self) -> u64 {
        self.snapshots.load(Ordering::Relaxed)
    }

    /// Counts `count` more snapshots of `each` bytes, unless the budget forbids it.
    pub(super) fn take(&self, count: usize, each: u64) -> Result<(), Rejection> {
        if let Some(whole) = &self.whole {
            whole.take(count, each)?;
        }
        let needed = count as u64 * each;
        let sessions = self.sessions.load(Ordering::Relaxed);
        let fits = |snapshots: u64| {
            Some(snapshots + needed).filter(|snapshots| sessions + snapshots <= self.budget)
        };
        let taken = self.snapshots.fetch_update(Ordering::Relaxed, Ordering::Relaxed, fits);
        taken.map(|_| ()).map_err(|snapshots| {
            if let Some(whole) = &self.whole {
                whole.give_back(needed);
            }
            let mebibytes = |bytes: u64| format!("{:.1} MiB", bytes as f64 / f64::from(1 << 20));
            Rejection::new(
                Code::MemoryBudget,
                "snapshots",
                count,
                format!(
                    "they need {}, and {} of {} are taken; drop some (or serve {})",
                    mebibytes(needed),
                    mebibytes(sessions + snapshots),
                    mebibytes(self.budget),
                    self.option
                ),
            )
        })
    }

    pub(super) fn give_back(&self, bytes: u64) {
        if let Some(whole) = &self.whole {
            whole.give_back(bytes);
        }
        self.snapshots.fetch_sub(bytes, Ordering::Relaxed);
    }

    /// A number that no other snapshot of the server has.
    fn number(&self) -> u64 {
        match &self.whole {
            Some(whole) => whole.number(),
            None => self.numbers.fetch_add(1, Ordering::Relaxed) + 1,
        }
    }
}

/// One environment's snapshot.
#[derive(Clone)]
pub(super) enum Saved {
    /// A state to go on from.
    State(Arc<Env>),
    /// An imported one, which was checked and not needed yet.
    Recipe(Arc<Recipe>),
    /// No state, but how an episode shall begin.
    Placement(Arc<Placement>),
    /// A state of a live world.
    World(Arc<SavedWorld>),
}

/// The snapshots of one session; they end with it.
pub(super) struct Store {
    ledger: Arc<Ledger>,
    /// The session's task and options.
    identity: Identity,
    /// What a snapshot is counted with, bytes.
    each: u64,
    saved: BTreeMap<u64, Saved>,
}

impl Store {
    /// No snapshots of environments like this one.
    pub(super) fn new(ledger: Arc<Ledger>, like: &Env) -> Self {
        let each = like.memory_bytes();
        Self { ledger, identity: like.identity(), each, saved: BTreeMap::new() }
    }

    /// Makes room for `count` snapshots, which [`Self::put`] then fills.
    pub(super) fn make_room(&self, count: usize) -> Result<Room, Rejection> {
        self.ledger.take(count, self.each)?;
        Ok(Room { ledger: Arc::clone(&self.ledger), each: self.each, left: count })
    }

    /// Keeps a snapshot, and gives the number under which.
    pub(super) fn put(&mut self, room: &mut Room, saved: Saved) -> u64 {
        debug_assert!(room.left > 0);
        room.left -= 1;
        let number = self.ledger.number();
        self.saved.insert(number, saved);
        number
    }

    /// Has the state that a recipe leads to in place of the recipe.
    pub(super) fn replace(&mut self, number: u64, state: &Arc<Env>) {
        if let Some(saved) = self.saved.get_mut(&number) {
            *saved = Saved::State(Arc::clone(state));
        }
    }

    pub(super) fn get(&self, number: u64) -> Result<Saved, Rejection> {
        self.saved.get(&number).cloned().ok_or_else(|| {
            let allowed = format!(
                "this session has {} snapshots, and none of that number; export and import it to \
                 bring it from another session",
                self.saved.len()
            );
            Rejection::new(Code::UnknownSnapshot, "snapshot", number, allowed)
        })
    }

    /// Keeps how episodes shall begin, and gives the number under which.
    pub(super) fn place(&mut self, placement: Placement) -> Result<u64, Rejection> {
        let mut room = self.make_room(1)?;
        Ok(self.put(&mut room, Saved::Placement(Arc::new(placement))))
    }

    /// How episodes shall begin that are to be as the placement of this number.
    pub(super) fn placement(&self, number: u64) -> Result<Arc<Placement>, Rejection> {
        match self.get(number)? {
            Saved::Placement(placement) => Ok(placement),
            _ => {
                Err(Rejection::new(Code::UnknownSnapshot, "placement", number, "it is a snapshot"))
            }
        }
    }

    /// Drops a snapshot, if it is there.
    pub(super) fn forget(&mut self, number: u64) {
        if self.saved.remove(&number).is_some() {
            self.ledger.give_back(self.each);
        }
    }

    /// A snapshot as bytes.
    pub(super) fn export(&self, number: u64) -> Result<Vec<u8>, Rejection> {
        match self.get(number)? {
            Saved::State(env) => env.export(),
            Saved::Recipe(recipe) => recipe.to_bytes(),
            Saved::Placement(_) => Err(no_state(number)),
            Saved::World(_) => {
                let why = "states of live worlds stay in the server; record the world instead";
                Err(Rejection::new(Code::Unsupported, "snapshot", number, why))
            }
        }
    }

    /// Keeps the snapshot that `bytes` tell of, which may be anything. Its state is rebuilt when it
    /// is restored for the first time.
    pub(super) fn import(&mut self, bytes: &[u8]) -> Result<u64, Rejection> {
        let recipe = Recipe::from_bytes(bytes)?;
        self.identity.check(&recipe)?;
        let mut room = self.make_room(1)?;
        Ok(self.put(&mut room, Saved::Recipe(Arc::new(recipe))))
    }
}

impl Drop for Store {
    fn drop(&mut self) {
        self.ledger.give_back(self.saved.len() as u64 * self.each);
    }
}

/// The refusal of a placement where a snapshot was expected.
pub(super) fn no_state(number: u64) -> Rejection {
    Rejection::new(Code::UnknownSnapshot, "snapshot", number, "it is a placement, and no state")
}

/// Room for snapshots; what is not filled is given back.
pub(super) struct Room {
    ledger: Arc<Ledger>,
    each: u64,
    left: usize,
}

impl Drop for Room {
    fn drop(&mut self) {
        self.ledger.give_back(self.left as u64 * self.each);
    }
}

#[cfg(test)]
mod tests {
    use trocar_proto::Options;

    use super::*;
    use crate::registry::Registry;

    fn store(ledger: &Arc<Ledger>) -> (Store, Arc<Env>) {
        let mut env = Registry::builtin().make("EcmReach-v0", &Options::new()).unwrap();
        env.reset(Some(1));
        (Store::new(Arc::clone(ledger), &env), Arc::new(env))
    }

    #[test]
    fn snapshots_are_counted_until_they_are_gone() {
        let ledger = Arc::new(Ledger::new(3 * Env::MEMORY_BYTES));
        let (mut store, env) = store(&ledger);
        let mut room = store.make_room(2).unwrap();
        let number = store.put(&mut room, Saved::State(Arc::clone(&env)));
        drop(room); // one of two was not filled
        assert_eq!(ledger.snapshots(), Env::MEMORY_BYTES);
        ledger.set_sessions(Env::MEMORY_BYTES);
        let refusal = store.make_room(2).err().unwrap();
        assert_eq!((refusal.code, refusal.field.as_str()), (Code::MemoryBudget, "snapshots"));
        assert!(store.import(&env.export().unwrap()).is_ok());
        store.forget(number);
        store.forget(number);
        assert_eq!(ledger.snapshots(), Env::MEMORY_BYTES);
        drop(store);
        assert_eq!(ledger.snapshots(), 0);
    }

    #[test]
    fn a_client_s_snapshots_count_for_it_and_for_the_server() {
        let whole = Arc::new(Ledger::new(3 * Env::MEMORY_BYTES));
        let client = Arc::new(whole.of_client(Env::MEMORY_BYTES));
        let (one, _) = store(&client);
        let refusal = one.make_room(2).err().unwrap();
        assert!(refusal.allowed.contains("--client-memory"), "{refusal}");
        assert_eq!((whole.snapshots(), client.snapshots()), (0, 0));
        let room = one.make_room(1).unwrap();
        assert_eq!((whole.snapshots(), client.snapshots()), (Env::MEMORY_BYTES, Env::MEMORY_BYTES));
        let other = Arc::new(whole.of_client(u64::MAX));
        let (two, _) = store(&other);
        let refusal = two.make_room(3).err().unwrap();
        assert!(refusal.allowed.contains("serve --memory"), "{refusal}");
        drop(room);
        assert_eq!((whole.snapshots(), client.snapshots(), other.snapshots()), (0, 0, 0));
    }

    #[test]
    fn a_placement_is_counted_and_no_state() {
        let ledger = Arc::new(Ledger::new(2 * Env::MEMORY_BYTES));
        let (mut store, env) = store(&ledger);
        let number = store.place(Placement::default()).unwrap();
        assert!(store.placement(number).unwrap().is_empty());
        assert_eq!(store.export(number).unwrap_err().code, Code::UnknownSnapshot);
        let state = store.import(&env.export().unwrap()).unwrap();
        assert_eq!(store.placement(state).unwrap_err().code, Code::UnknownSnapshot);
        assert_eq!(store.place(Placement::default()).unwrap_err().code, Code::MemoryBudget);
        store.forget(number);
        assert_eq!(ledger.snapshots(), Env::MEMORY_BYTES);
    }

    #[test]
    fn no_two_sessions_have_a_number_in_common() {
        let ledger = Arc::new(Ledger::new(1 << 30));
        let (mut one, env) = store(&ledger);
        let (mut two, _) = store(&ledger);
        let first = one.import(&env.export().unwrap()).unwrap();
        let second = two.import(&env.export().unwrap()).unwrap();
        assert_ne!(first, second);
        assert_eq!(one.get(second).err().unwrap().code, Code::UnknownSnapshot);
    }
}
