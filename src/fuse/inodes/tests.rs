// SPDX-License-Identifier: MIT

use std::sync::LazyLock;

use proptest::prelude::*;

use super::*;
use crate::fs::{DfItem, Item};

const FILE: Node = node_of(0);
const OTHER: Node = node_of(1);
const THREAD: Sharing = Sharing::By(100);
const OTHER_THREAD: Sharing = Sharing::By(101);

const fn node_of(file: u32) -> Node {
    Node::Of(0, Item::Df(DfItem::Raw(file as u8)))
}

fn at(millis: u64) -> Now {
    static START: LazyLock<Instant> = LazyLock::new(Instant::now);
    let after = Duration::from_millis(millis);
    Now { instant: *START + after, time: SystemTime::UNIX_EPOCH + after }
}

fn delay() -> u64 {
    RENEWAL_DELAY.as_millis() as u64
}

fn bytes(text: &str) -> Value {
    Value::Bytes(text.as_bytes().into())
}

fn inodes() -> Inodes<u32> {
    Inodes::new(at(0))
}

/// Gives a nodeid the file's present value if it is due, as GETATTR does.
fn renew(inodes: &mut Inodes<u32>, number: u64, value: Value, now: Now) -> bool {
    let due = inodes.due(number, now).is_some();
    if due {
        inodes.renew(number, value, now);
    }
    due
}

fn shown(inodes: &Inodes<u32>, number: u64, millis: u64) -> Shown {
    inodes.shown(number, at(millis)).expect("the nodeid is known")
}

/// All nodes.
const ALL: RangeInclusive<u32> = 0..=u32::MAX;

fn value(inodes: &Inodes<u32>, number: u64) -> &Value {
    inodes.get(number).expect("the nodeid is known").value()
}

#[test]
fn an_unchanged_value_keeps_its_nodeid() {
    let mut inodes = inodes();
    let first = inodes.enter(FILE, bytes("1\n"), THREAD, at(0));
    assert_eq!(first.size, 2);
    assert_eq!(inodes.enter(FILE, bytes("1\n"), OTHER_THREAD, at(5)), first);
    assert_ne!(inodes.enter(OTHER, bytes("1\n"), THREAD, at(5)).number, first.number);
}

#[test]
fn a_changed_value_gets_a_new_nodeid_and_the_old_one_keeps_its_bytes() {
    let mut inodes = inodes();
    let old = inodes.enter(FILE, bytes("9\n"), THREAD, at(0));
    let new = inodes.enter(FILE, bytes("10\n"), THREAD, at(5));
    assert_ne!(new.number, old.number);
    assert_eq!((new.size, new.since), (3, at(5).time));
    assert_eq!(shown(&inodes, old.number, 5), old);
    assert_eq!(value(&inodes, old.number), &bytes("9\n"));
    // An old value that comes back gets a nodeid of its own.
    let again = inodes.enter(FILE, bytes("9\n"), THREAD, at(9));
    assert!(again.number != old.number && again.number != new.number);
}

#[test]
fn a_retired_nodeid_is_not_found_again() {
    let mut inodes = inodes();
    let old = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    inodes.retire(old, at(1));
    assert_eq!(inodes.current(FILE), None);
    assert_eq!(inodes.up_to_date(&ALL).count(), 0);
    assert_ne!(inodes.enter(FILE, bytes("1\n"), THREAD, at(2)).number, old);
}

#[test]
fn forget_drops_a_nodeid_when_all_lookups_are_taken_back() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    inodes.enter(FILE, bytes("1\n"), THREAD, at(0));
    inodes.forget(number, 1);
    assert!(inodes.get(number).is_some());
    inodes.forget(number, 1);
    assert!(inodes.get(number).is_none());
    assert_eq!(inodes.current(FILE), None);
    assert_ne!(inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number, number, "numbers are not reused");
    // Neither an unknown number nor a count that is too large does any harm.
    inodes.forget(number, 1);
    inodes.forget(number + 1, u64::MAX);
}

#[test]
fn forgetting_a_superseded_nodeid_leaves_the_current_one() {
    let mut inodes = inodes();
    let old = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    let new = inodes.enter(FILE, bytes("2\n"), THREAD, at(1)).number;
    inodes.forget(old, 1);
    assert_eq!(inodes.current(FILE), Some(new));
}

#[test]
fn a_listing_that_the_kernel_has_had_for_long_is_dropped_once() {
    let kept = LISTING_KEPT.as_millis() as u64;
    let mut inodes = inodes();
    assert!(!inodes.has_rested(Node::Root, at(kept)), "the kernel has none");
    for turn in [0, 5] {
        inodes.listed(Node::Root, 1, false, at(turn * kept));
        assert!(!inodes.has_rested(Node::Root, at((turn + 1) * kept - 1)));
        let before = inodes.fixed(Node::Root).since;
        assert!(inodes.has_rested(Node::Root, at((turn + 1) * kept)));
        assert!(!inodes.is_listed(Node::Root) && !inodes.has_rested(Node::Root, at((turn + 2) * kept)));
        assert_eq!(inodes.fixed(Node::Root).since, before + Duration::from_nanos(1));
    }
}

#[test]
fn folders_have_the_time_of_the_mount_until_their_names_change() {
    let mut inodes = inodes();
    assert_eq!(inodes.fixed(Node::Root).number, 1, "FUSE_ROOT_ID");
    let time = |inodes: &Inodes<u32>| inodes.fixed(Node::Root).since;
    assert!(!inodes.has_outdated(Node::Root, 1, at(50)), "the kernel does not have them");
    inodes.listed(Node::Root, 1, false, at(50));
    assert!(inodes.is_listed(Node::Root) && !inodes.has_outdated(Node::Root, 1, at(60)));
    assert_eq!(time(&inodes), at(0).time);
    assert!(inodes.has_outdated(Node::Root, 2, at(77)));
    assert!(!inodes.has_outdated(Node::Root, 2, at(88)), "once");
    assert_eq!(time(&inodes), at(77).time);
    // Half of each.
    inodes.listed(Node::Root, 2, false, at(50));
    inodes.listed(Node::Root, 3, true, at(50));
    assert!(inodes.has_outdated(Node::Root, 3, at(99)));
}

/// As many nodeids that are in use as the table keeps in any case.
fn crowd(inodes: &mut Inodes<u32>, millis: u64) {
    for _ in 0..SPARE {
        inodes.enter(OTHER, bytes("1\n"), Sharing::Alone, at(millis));
    }
}

/// Drops what rests, as if there were many.
fn drop_resting(inodes: &mut Inodes<u32>, millis: u64) {
    inodes.room = 0;
    inodes.tidy(at(millis));
}

#[test]
fn nodeids_that_nobody_uses_are_dropped_when_there_are_many() {
    let in_use = IN_USE.as_millis() as u64;
    for (sharing, is_read, stays) in [
        (Sharing::Alone, false, in_use),
        (Sharing::Alone, true, READ_THROUGH.as_millis() as u64),
        (THREAD, true, READ_THROUGH.as_millis() as u64),
        // The kernel has its name, and does not ask.
        (Sharing::All, true, in_use),
    ] {
        let mut inodes = inodes();
        let number = inodes.enter(FILE, bytes("1\n"), sharing, at(0)).number;
        if is_read {
            inodes.served(number, 4096, at(0));
        }
        inodes.tidy(at(9 * in_use));
        assert!(inodes.get(number).is_some(), "there are few");
        crowd(&mut inodes, 9 * in_use);
        inodes.tidy(at(9 * in_use));
        assert!(inodes.get(number).is_none(), "{sharing:?}");
        assert_eq!((inodes.current(FILE), inodes.live.len()), (None, SPARE));

        let number = inodes.enter(FILE, bytes("1\n"), sharing, at(9 * in_use)).number;
        if is_read {
            inodes.served(number, 4096, at(9 * in_use));
        }
        drop_resting(&mut inodes, 9 * in_use + stays - 1);
        assert!(inodes.get(number).is_some(), "{sharing:?}");
    }
}

/// Reading whole trees adds many at once, and nothing afterwards.
#[test]
fn regression_nodeids_of_a_burst_stayed_for_as_long_as_nobody_entered_another_one() {
    let mut inodes = inodes();
    for turn in 0..100 {
        for _ in 0..SPARE {
            inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(turn));
        }
        inodes.tidy(at(turn));
    }
    assert_eq!(inodes.live.len(), 100 * SPARE, "they are in use");
    inodes.tidy(at(60_000));
    assert_eq!(inodes.live.len(), 0);
}

#[test]
fn a_nodeid_that_is_being_read_or_written_does_not_rest() {
    let mut inodes = inodes();
    let read = inodes.enter(FILE, Value::Unread(4096), Sharing::Alone, at(0)).number;
    let written = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(0)).number;
    inodes.wait(read, 1);
    inodes.write_begins(written, at(0));
    drop_resting(&mut inodes, 60_000);
    assert_eq!(inodes.live.len(), 2);
    inodes.arrived(read, Some(&b"1\n"[..].into()), at(60_000)).expect("it is known");
    inodes.write_ends(written, bytes("2\n"), at(60_000));
    drop_resting(&mut inodes, 60_100);
    assert_eq!(inodes.live.len(), 2, "they are to be read now");
}

/// Somebody sets its times, for example: a slow reader then got ESTALE. So did one of two readers whose answer the
/// kernel used only after the other had read.
#[test]
fn regression_a_nodeid_whose_bytes_the_kernel_drops_rested_as_one_that_was_read() {
    for (sharing, is_read_again) in
        [Sharing::Alone, THREAD].into_iter().flat_map(|one| [(one, false), (one, true)])
    {
        let mut inodes = inodes();
        let number = inodes.enter(FILE, bytes("1\n"), sharing, at(0)).number;
        inodes.served(number, 4096, at(0));
        inodes.touch(number);
        inodes.settle(number, at(10));
        if is_read_again {
            inodes.served(number, 4096, at(10));
        }
        drop_resting(&mut inodes, 10 + IN_USE.as_millis() as u64 - 1);
        assert!(inodes.get(number).is_some(), "{sharing:?}");
    }
}

#[test]
fn a_nodeid_that_rests_is_renewed_when_it_is_used_again() {
    let mut inodes = inodes();
    let entered = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(0));
    drop_resting(&mut inodes, 60_000);
    assert!(inodes.live.is_empty());
    assert_eq!(node(entered.number), Some(FILE));
    inodes.wake(entered.number, bytes("22\n"), Sharing::Alone, at(60_000));
    let woken = shown(&inodes, entered.number, 60_000);
    assert_eq!((woken.size, woken.valid), (3, Duration::ZERO));
    assert!(woken.since > entered.since, "the kernel drops the bytes that it has");
    // Nobody knows how often it was looked up.
    inodes.forget(entered.number, 1);
    assert!(inodes.get(entered.number).is_some());
    // In use it stays as it is.
    inodes.wake(entered.number, bytes("333\n"), Sharing::Alone, at(60_001));
    assert_eq!(value(&inodes, entered.number), &bytes("22\n"));
}

/// The kernel still has its bytes.
#[test]
fn a_lookup_finds_the_nodeid_of_an_unchanged_value_again_after_a_rest() {
    let rest = IN_USE.as_millis() as u64;
    for sharing in [Sharing::All, THREAD] {
        let mut inodes = inodes();
        let first = inodes.enter(FILE, bytes("1\n"), sharing, at(0));
        drop_resting(&mut inodes, rest);
        assert!(inodes.live.is_empty());
        assert_eq!(inodes.enter(FILE, bytes("1\n"), sharing, at(2 * rest)), first, "{sharing:?}");
        // The kernel may have looked it up before.
        inodes.forget(first.number, 1);
        assert!(inodes.get(first.number).is_some());
        drop_resting(&mut inodes, 3 * rest);
        let second = inodes.enter(FILE, bytes("2\n"), sharing, at(4 * rest)).number;
        assert_ne!(second, first.number, "another value: {sharing:?}");
        drop_resting(&mut inodes, 5 * rest);
        let third = inodes.enter(FILE, bytes("1\n"), sharing, at(6 * rest)).number;
        assert!(third != first.number && third != second, "{sharing:?}");
    }
}

/// The value that it shows then may be another one, or the kernel may have been told to drop its bytes.
#[test]
fn a_nodeid_that_was_used_after_its_rest_or_renewed_or_written_is_not_found_again() {
    let rest = IN_USE.as_millis() as u64;
    type Step = fn(&mut Inodes<u32>, u64);
    let steps: [Step; 5] = [
        |inodes, number| {
            drop_resting(inodes, IN_USE.as_millis() as u64);
            inodes.wake(number, bytes("2\n"), THREAD, at(IN_USE.as_millis() as u64));
            drop_resting(inodes, 2 * IN_USE.as_millis() as u64);
        },
        |inodes, number| inodes.retire(number, at(1)),
        |inodes, number| inodes.renew(number, bytes("1\n"), at(1)),
        |inodes, number| inodes.touch(number),
        |inodes, number| {
            inodes.write_begins(number, at(1));
            inodes.write_ends(number, bytes("1\n"), at(1));
        },
    ];
    for (which, step) in steps.into_iter().enumerate() {
        let mut inodes = inodes();
        let number = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
        step(&mut inodes, number);
        drop_resting(&mut inodes, 4 * rest);
        assert_ne!(inodes.enter(FILE, bytes("1\n"), THREAD, at(5 * rest)).number, number, "{which}");
    }
}

#[test]
fn numbers_of_what_rests_are_not_given_to_others() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    drop_resting(&mut inodes, IN_USE.as_millis() as u64);
    inodes.turn = 0;
    assert_ne!(inodes.enter(FILE, bytes("2\n"), Sharing::Alone, at(60_000)).number, number);
}

/// A poll concerns the gauge's own files.
#[test]
fn nodeids_are_looked_at_by_their_gauge() {
    let mut inodes = inodes();
    let nodes = [0, 1, 2].map(|gauge| Node::Of(gauge, Item::Df(DfItem::Raw(0))));
    let numbers = nodes.map(|node| inodes.enter(node, bytes("1\n"), Sharing::All, at(0)).number);
    for (gauge, number) in (0..).zip(numbers) {
        let found: Vec<u64> = inodes.up_to_date(&Node::of_gauge(gauge)).map(|(number, ..)| number).collect();
        assert_eq!(found, [number]);
    }
}

/// As long as the kernel may use the name without asking, from whenever it has got the answer on.
#[test]
fn the_kernel_is_notified_only_while_it_may_keep_a_name() {
    let kept = Duration::from_millis(700);
    let over = (kept + NAME_OVER).as_millis() as u64;
    for (named, millis, expected) in [(kept, over - 1, true), (kept, over, false), (Duration::ZERO, 0, false)]
    {
        let table = std::sync::Mutex::new(inodes());
        let number =
            look_up(&table, FILE, || Some(bytes("1\n")), (Sharing::All, named), at(0)).expect("there");
        let outdated = |value: Value| retire_outdated(&table, &[ALL], |_| value.clone(), || at(millis)).names;
        assert!(!outdated(bytes("1\n")), "the same value");
        assert_eq!(outdated(bytes("2\n")), expected, "{named:?} {millis}");
        let inodes = table.lock().expect("no panic");
        assert!(inodes.current(FILE).is_none() && inodes.get(number.number).is_some());
    }
}

/// The attributes that came with such a name would keep an open file from following.
#[test]
fn attributes_are_dropped_that_the_kernel_would_trust_for_too_long() {
    let long = Duration::from_secs(10);
    let over = (long - RENEWAL_DELAY).as_millis() as u64;
    for (sharing, kept, millis, dropped) in [
        (Sharing::All, long, 0, true),
        (Sharing::All, long, over - 1, true),
        (Sharing::All, long, over, false),
        (Sharing::All, RENEWAL_DELAY, 0, false),
        (Sharing::All, Duration::ZERO, 0, false),
        (THREAD, Duration::ZERO, 0, false),
    ] {
        let table = std::sync::Mutex::new(inodes());
        let shown = look_up(&table, FILE, || Some(bytes("1\n")), (sharing, kept), at(0)).expect("there");
        let most = if sharing == Sharing::All { RENEWAL_DELAY } else { READ_THROUGH / 2 };
        assert_eq!(shown.valid, most.max(kept), "{kept:?}");
        let later = kept.saturating_sub(Duration::from_secs(3)).max(most);
        let asked = table.lock().expect("no panic").show(shown.number, at(3000)).expect("it is known");
        assert_eq!(asked.valid, later, "{kept:?}: GETATTR");
        let outdated = retire_outdated(&table, &[ALL], |_| bytes("2\n"), || at(millis));
        assert_eq!(
            outdated.attributes,
            if dropped { vec![shown.number] } else { vec![] },
            "{kept:?} {millis}"
        );
        // What shows an old value already is asked for when it is due.
        let again = look_up(&table, FILE, || Some(bytes("2\n")), (sharing, kept), at(millis)).expect("there");
        assert_ne!(again.number, shown.number);
    }
}

#[test]
fn a_nodeid_does_not_rest_while_the_kernel_may_keep_its_name() {
    let table = std::sync::Mutex::new(inodes());
    let long = Duration::from_secs(10);
    let number =
        look_up(&table, FILE, || Some(bytes("1\n")), (Sharing::All, long), at(0)).expect("there").number;
    let over = (long + NAME_OVER).as_millis() as u64;
    let mut inodes = table.into_inner().expect("no panic");
    for (millis, is_known) in [(over - 1, true), (over, false)] {
        drop_resting(&mut inodes, millis);
        assert_eq!(inodes.get(number).is_some(), is_known, "{millis}");
    }
}

#[test]
fn what_may_be_written_is_leased_while_nobody_writes_to_its_gauge() {
    let mut inodes = inodes();
    let other_gauge = Node::Of(1, Item::Df(DfItem::Raw(0)));
    let read = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(0));
    assert_eq!(read.valid, LEASE);
    let writes = inodes.enter(OTHER, bytes("1\n"), Sharing::Alone, at(10));
    // A write waits for the other's lease, and for none of another gauge.
    assert_eq!(inodes.leases(writes.number, at(10)), LEASE_OVER - Duration::from_millis(10));
    assert_eq!(inodes.leases(read.number, at(10)), LEASE_OVER);
    assert_eq!(inodes.leases(writes.number, at(30)), Duration::ZERO);
    inodes.enter(other_gauge, bytes("1\n"), Sharing::Alone, at(30));
    assert_eq!(inodes.leases(writes.number, at(30)), Duration::ZERO);
    inodes.write_begins(writes.number, at(30));
    let valid =
        |inodes: &mut Inodes<u32>, number, millis| inodes.show(number, at(millis)).expect("known").valid;
    assert_eq!(valid(&mut inodes, read.number, 30), Duration::ZERO, "a write to the gauge is under way");
    let new = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(31));
    assert_eq!(new.valid, Duration::ZERO);
    assert_eq!(inodes.enter(other_gauge, bytes("1\n"), Sharing::Alone, at(31)).valid, LEASE);
    inodes.retire(read.number, at(32));
    inodes.write_ends(writes.number, bytes("2\n"), at(32));
    assert_eq!(valid(&mut inodes, new.number, 33), LEASE);
    assert_eq!(valid(&mut inodes, read.number, 33), Duration::ZERO, "it shows an old value");
    assert_eq!(valid(&mut inodes, writes.number, 33), Duration::ZERO, "its time has to differ");
    inodes.settle(writes.number, at(33 + SETTLING.as_millis() as u64));
    assert_eq!(valid(&mut inodes, writes.number, 33 + SETTLING.as_millis() as u64), LEASE);
    // What is forgotten is used by nobody.
    inodes.forget(new.number, 1);
    inodes.forget(read.number, 1);
    assert_eq!(inodes.leases(writes.number, at(34)), Duration::ZERO);
}

#[test]
fn an_unread_value_is_leased_when_it_has_arrived() {
    let mut inodes = inodes();
    let unread = inodes.enter(FILE, Value::Unread(4096), Sharing::Alone, at(0));
    assert_eq!(unread.valid, Duration::ZERO);
    inodes.wait(unread.number, 1);
    let (shown, _) = inodes.arrived(unread.number, Some(&b"1\n"[..].into()), at(1)).expect("it is known");
    assert_eq!(shown.valid, LEASE);
}

#[test]
fn an_unread_file_has_a_nodeid_for_each_thread() {
    let mut inodes = inodes();
    let mut enter = |sharing| inodes.enter(FILE, Value::Unread(4096), sharing, at(0)).number;
    let first = enter(THREAD);
    assert_eq!(enter(THREAD), first);
    let second = enter(OTHER_THREAD);
    assert_ne!(second, first);
    // Threads of other PID namespaces cannot be told apart.
    let unknown = enter(Sharing::By(0));
    assert_ne!(enter(Sharing::By(0)), unknown);
}

#[test]
fn a_nodeid_whose_value_is_awaited_is_not_shared() {
    let mut inodes = inodes();
    let awaited = inodes.enter(FILE, Value::Unread(4096), THREAD, at(0)).number;
    assert!(inodes.wait(awaited, 1));
    assert_ne!(inodes.enter(FILE, Value::Unread(4096), THREAD, at(0)).number, awaited);
}

#[test]
fn a_value_that_arrives_answers_all_who_wait_and_is_found_by_lookups() {
    let mut inodes = inodes();
    let mine = inodes.enter(FILE, Value::Unread(4096), THREAD, at(0)).number;
    let theirs = inodes.enter(FILE, Value::Unread(4096), OTHER_THREAD, at(0)).number;
    assert!(inodes.wait(mine, 1), "the first asks for the value");
    assert!(!inodes.wait(mine, 2));
    assert!(inodes.wait(theirs, 3), "a different nodeid waits for itself");
    let (shown, waiters) = inodes.arrived(mine, Some(&b"3000\n"[..].into()), at(3)).expect("it is known");
    assert_eq!((shown.size, waiters), (5, vec![1, 2]));
    assert_eq!(inodes.enter(FILE, bytes("3000\n"), Sharing::By(102), at(4)).number, mine);
    assert!(inodes.get(theirs).is_some_and(Inode::is_unread));
    let (_, waiters) = inodes.arrived(theirs, Some(&b"3000\n"[..].into()), at(5)).expect("it is known");
    assert_eq!(waiters, [3]);
}

#[test]
fn a_value_that_cannot_be_read_leaves_the_file_unread() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, Value::Unread(4096), THREAD, at(0)).number;
    inodes.wait(number, 1);
    let (shown, waiters) = inodes.arrived(number, None, at(3)).expect("it is known");
    assert_eq!((shown.size, waiters), (4096, vec![1]));
    assert!(inodes.wait(number, 2), "the next reader asks again");
}

#[test]
fn a_value_that_arrives_for_a_forgotten_nodeid_is_dropped() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, Value::Unread(4096), THREAD, at(0)).number;
    inodes.wait(number, 1);
    inodes.forget(number, 1);
    assert!(inodes.arrived(number, Some(&b"1\n"[..].into()), at(3)).is_none());
    assert_eq!(inodes.current(FILE), None);
}

#[test]
fn a_file_that_may_be_written_has_a_nodeid_for_each_lookup() {
    let mut inodes = inodes();
    let first = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(0));
    let second = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(1));
    let other = inodes.enter(OTHER, Value::Unread(4096), Sharing::Alone, at(1));
    assert!(first.number != second.number && first.node == second.node);
    inodes.wait(other.number, 1);
    inodes.arrived(other.number, Some(&b"2\n"[..].into()), at(3)).expect("it is known");
    assert_eq!(inodes.current(OTHER), None);
    assert_ne!(inodes.enter(OTHER, bytes("2\n"), Sharing::Alone, at(4)).number, other.number);
    inodes.forget(first.number, 1);
    inodes.forget(second.number, 1);
    // A write through one of them leaves the others as they are, until its outcome is known.
    let writes = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(6)).number;
    let reads = inodes.enter(FILE, bytes("1\n"), Sharing::Alone, at(6)).number;
    inodes.write_begins(writes, at(7));
    assert_eq!((inodes.due(reads, at(8)), value(&inodes, reads)), (None, &bytes("1\n")));
    inodes.retire(reads, at(9));
    assert_eq!((inodes.due(reads, at(9)), inodes.due(writes, at(9))), (Some(FILE), None));
    inodes.write_ends(writes, bytes("22\n"), at(9));
    assert_eq!(value(&inodes, writes), &bytes("22\n"));
}

/// Before each read of one, the kernel has to ask.
#[test]
fn attributes_of_an_unread_value_are_not_valid_for_any_time() {
    for sharing in [Sharing::Alone, THREAD] {
        let mut inodes = inodes();
        let number = inodes.enter(FILE, Value::Unread(4096), sharing, at(0)).number;
        assert_eq!(shown(&inodes, number, 0).valid, Duration::ZERO, "{sharing:?}");
        inodes.wait(number, 1);
        inodes.arrived(number, None, at(1));
        assert_eq!(shown(&inodes, number, 1).valid, Duration::ZERO, "{sharing:?}");
        inodes.wait(number, 1);
        inodes.arrived(number, Some(&b"3000\n"[..].into()), at(1));
        let valid = if sharing == Sharing::Alone { Duration::ZERO } else { READ_THROUGH / 2 };
        assert_eq!(shown(&inodes, number, 1).valid, valid, "{sharing:?}");
    }
}

#[test]
fn who_asks_twice_without_a_lookup_has_the_file_open() {
    for sharing in [Sharing::Alone, THREAD] {
        let mut inodes = inodes();
        let mut enter = |at_time| inodes.enter(FILE, Value::Unread(4096), sharing, at(at_time)).number;
        let (first, second) = (enter(0), enter(1));
        assert!(!inodes.ask(second), "stat or open: {sharing:?}");
        assert!(inodes.ask(second) && inodes.ask(second), "fstat: {sharing:?}");
        assert_eq!(inodes.ask(first), sharing == THREAD, "threads have one nodeid: {sharing:?}");
        let third = inodes.enter(FILE, Value::Unread(4096), sharing, at(2)).number;
        inodes.overwrite(third);
        assert!(!inodes.ask(third) && !inodes.ask(third), "to overwrite it: {sharing:?}");
        let fourth = inodes.enter(FILE, Value::Unread(4096), sharing, at(3)).number;
        assert!(!inodes.ask(fourth) && inodes.ask(fourth), "looked up again: {sharing:?}");
    }
}

#[test]
fn a_superseded_nodeid_is_renewed_only_after_the_delay() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    assert_eq!(inodes.due(number, at(9 * delay())), None, "its value has not changed");
    inodes.retire(number, at(10));
    inodes.retire(number, at(500));
    assert!(!renew(&mut inodes, number, bytes("22\n"), at(9 + delay())));
    assert_eq!(value(&inodes, number), &bytes("1\n"));
    assert!(renew(&mut inodes, number, bytes("22\n"), at(10 + delay())));
    assert_eq!(shown(&inodes, number, 10 + delay()).size, 3);
    assert_eq!(inodes.due(number, at(9 * delay())), None);
    assert_eq!(inodes.up_to_date(&ALL).count(), 1, "a change of the new value is noticed");
}

#[test]
fn attributes_are_not_valid_beyond_a_renewal() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), Sharing::All, at(0)).number;
    assert_eq!(shown(&inodes, number, 100).valid, RENEWAL_DELAY);
    inodes.retire(number, at(100));
    assert_eq!(shown(&inodes, number, 300).valid, RENEWAL_DELAY - Duration::from_millis(200));
    assert_eq!(shown(&inodes, number, 5 * delay()).valid, Duration::ZERO);
    inodes.write_begins(number, at(300));
    assert_eq!(shown(&inodes, number, 300).valid, Duration::ZERO);
}

/// Readers past the kernel's copy are answered only while it is in use.
#[test]
fn attributes_are_not_valid_for_longer_than_a_nodeid_that_was_read_is_in_use() {
    for sharing in [Sharing::Alone, THREAD, Sharing::All] {
        let mut inodes = inodes();
        let number = inodes.enter(FILE, bytes("1\n"), sharing, at(0)).number;
        inodes.served(number, 4096, at(0));
        for is_superseded in [false, true] {
            if is_superseded {
                inodes.retire(number, at(0));
            }
            let valid = shown(&inodes, number, 0).valid;
            assert!(
                !inodes.live[&key(number)].rests(Now { instant: at(0).instant + valid, ..at(0) }),
                "{sharing:?}"
            );
        }
    }
}

#[test]
fn a_renewed_nodeid_has_a_new_time_for_each_reader_until_it_has_settled() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), Sharing::All, at(0)).number;
    let mut times = vec![shown(&inodes, number, 0).since];
    // The calendar's clock need not have advanced.
    inodes.renew(number, bytes("1\n"), at(0));
    for millis in [0, 1, 49] {
        inodes.settle(number, at(millis));
        let now = shown(&inodes, number, millis);
        assert_eq!(now.valid, Duration::ZERO);
        assert!(!times.contains(&now.since), "at {millis} ms");
        times.push(now.since);
    }
    inodes.settle(number, at(50));
    let settled = shown(&inodes, number, 50);
    assert_eq!((settled.valid, Some(&settled.since)), (RENEWAL_DELAY, times.last()));
}

#[test]
fn a_nodeid_that_is_renewed_with_an_unread_value_settles_when_the_value_has_arrived() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    inodes.renew(number, Value::Unread(4096), at(0));
    inodes.wait(number, 1);
    inodes.arrived(number, Some(&b"22\n"[..].into()), at(700));
    inodes.settle(number, at(701));
    assert_eq!(shown(&inodes, number, 701).valid, Duration::ZERO);
    inodes.settle(number, at(750));
    assert_eq!(shown(&inodes, number, 750).valid, READ_THROUGH / 2);
}

#[test]
fn a_nodeid_that_is_being_read_is_not_renewed() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    inodes.retire(number, at(0));
    inodes.wait(number, 1);
    assert!(!renew(&mut inodes, number, bytes("2\n"), at(3 * delay())));
}

#[test]
fn a_nodeid_that_is_being_written_waits_for_the_end_of_the_write() {
    let mut inodes = inodes();
    let number = inodes.enter(FILE, bytes("1\n"), THREAD, at(0)).number;
    inodes.write_begins(number, at(0));
    inodes.write_begins(number, at(0));
    assert_eq!(inodes.current(FILE), None, "lookups no longer find it");
    assert!(!renew(&mut inodes, number, bytes("2\n"), at(5 * delay())));
    inodes.write_ends(number, bytes("2\n"), at(5 * delay()));
    assert_eq!(value(&inodes, number), &bytes("1\n"), "there is another write");
    inodes.write_ends(number, bytes("3\n"), at(5 * delay()));
    assert_eq!(value(&inodes, number), &bytes("3\n"));
    assert_eq!(inodes.current(FILE), None);
}

#[derive(Clone, Debug)]
enum Step {
    /// A file gets another value of a random length, which may have to be read from the gauge.
    Change(u32, usize, bool),
    /// A thread looks up a file.
    Lookup(u32, u32),
    Forget(usize, u64),
    Read(usize),
    /// The gauge answers the READs of a nodeid, or fails to.
    Arrive(usize, bool),
    WriteBegins(usize),
    WriteEnds(usize),
    /// The nodeids whose files have changed are retired.
    Announce,
    /// A nodeid is renewed if it is due.
    Renew(usize),
    /// What rests is dropped, as when there are many.
    Tidy,
    Wait(u64),
}

fn step() -> impl Strategy<Value = Step> {
    let nodeid = any::<usize>;
    prop_oneof![
        2 => (0..3u32, 0..20usize, any::<bool>()).prop_map(|(a, b, c)| Step::Change(a, b, c)),
        4 => (0..3u32, 1..3u32).prop_map(|(file, thread)| Step::Lookup(file, thread)),
        1 => (nodeid(), 1..3u64).prop_map(|(number, lookups)| Step::Forget(number, lookups)),
        2 => nodeid().prop_map(Step::Read),
        2 => (nodeid(), any::<bool>()).prop_map(|(number, ok)| Step::Arrive(number, ok)),
        1 => nodeid().prop_map(Step::WriteBegins),
        1 => nodeid().prop_map(Step::WriteEnds),
        1 => Just(Step::Announce),
        2 => nodeid().prop_map(Step::Renew),
        1 => Just(Step::Tidy),
        1 => (0..2 * delay()).prop_map(Step::Wait),
    ]
}

/// That file may be written.
const WRITABLE: u32 = 2;

/// What a nodeid has to show.
struct Known {
    file: u32,
    thread: u32,
    lookups: u64,
    last_lookup: u64,
    /// `None` before the first READ is answered.
    bytes: Option<Vec<u8>>,
    writing: u32,
    waiting: Vec<u32>,
    has_rested: bool,
}

/// A small reference model of the table.
struct Model {
    now: u64,
    /// The files: what they hold, and whether that has been read from the gauge.
    files: Vec<(Vec<u8>, bool)>,
    /// The nodeid of each file's last lookup, until something but the file's value replaces it.
    last: HashMap<u32, u64>,
    known: BTreeMap<u64, Known>,
    /// Makes values and requests unique.
    count: u32,
}

fn read_bytes((bytes, read): &(Vec<u8>, bool)) -> Option<Vec<u8>> {
    read.then(|| bytes.clone())
}

fn as_value(bytes: Option<&[u8]>) -> Value {
    bytes.map_or(Value::Unread(4096), |bytes| Value::Bytes(bytes.into()))
}

impl Model {
    fn new() -> Self {
        let files = (0..3).map(|file| (vec![b'a' + file], true)).collect();
        Self { now: 0, files, last: HashMap::new(), known: BTreeMap::new(), count: 0 }
    }

    fn bytes(&self, file: u32) -> Option<Vec<u8>> {
        read_bytes(&self.files[file as usize])
    }

    fn value(&self, file: u32) -> Value {
        as_value(self.bytes(file).as_deref())
    }

    /// A nodeid known to the kernel.
    fn pick(&self, at: usize) -> Option<u64> {
        self.known.keys().nth(at.checked_rem(self.known.len())?).copied()
    }

    fn unique(&mut self) -> u32 {
        self.count += 1;
        self.count
    }

    /// Does a step here and in the table, and compares what the table returns.
    fn apply(&mut self, step: &Step, inodes: &mut Inodes<u32>) {
        let now = at(self.now);
        match *step {
            Step::Change(file, length, read) => {
                let text = format!("{}{}", self.unique(), "x".repeat(length));
                self.files[file as usize] = (text.into_bytes(), read);
            }
            Step::Lookup(file, thread) => self.look_up(file, thread, inodes),
            Step::Forget(picked, lookups) => {
                let Some(number) = self.pick(picked) else { return };
                let known = self.known.get_mut(&number).expect("it was picked");
                // The kernel does not forget a file that is in use.
                if known.writing > 0 || !known.waiting.is_empty() {
                    return;
                }
                let lookups = lookups.min(known.lookups);
                known.lookups -= lookups;
                let (is_last, has_rested) = (known.lookups == 0, known.has_rested);
                inodes.forget(number, lookups);
                if is_last {
                    self.known.remove(&number);
                }
                if is_last && has_rested {
                    // It stays until it rests.
                    inodes.live.remove(&key(number)).expect("nobody knows how often it was looked up");
                    inodes.drop_current(number);
                }
            }
            Step::Read(picked) => {
                let (Some(number), request) = (self.pick(picked), self.unique()) else { return };
                let known = self.known.get_mut(&number).expect("it was picked");
                if known.bytes.is_none() {
                    assert_eq!(inodes.wait(number, request), known.waiting.is_empty());
                    known.waiting.push(request);
                }
            }
            Step::Arrive(picked, ok) => {
                let Some(number) = self.pick(picked) else { return };
                let known = self.known.get_mut(&number).expect("it was picked");
                if known.waiting.is_empty() {
                    return;
                }
                let (bytes, read) = &mut self.files[known.file as usize];
                let value: Option<Arc<[u8]>> = ok.then(|| bytes.as_slice().into());
                let (_, waiters) = inodes.arrived(number, value.as_ref(), now).expect("it is known");
                assert_eq!(waiters, std::mem::take(&mut known.waiting));
                if ok {
                    *read = true;
                    known.bytes = Some(bytes.clone());
                    self.last.remove(&known.file);
                }
            }
            Step::WriteBegins(picked) => {
                let Some(number) = self.pick(picked) else { return };
                let known = self.known.get_mut(&number).expect("it was picked");
                known.writing += 1;
                self.last.remove(&known.file);
                inodes.write_begins(number, now);
            }
            Step::WriteEnds(picked) => {
                let Some(number) = self.pick(picked) else { return };
                let known = self.known.get_mut(&number).expect("it was picked");
                if known.writing == 0 {
                    return;
                }
                let bytes = read_bytes(&self.files[known.file as usize]);
                inodes.write_ends(number, as_value(bytes.as_deref()), now);
                known.writing -= 1;
                if known.writing == 0 {
                    known.bytes = bytes;
                }
            }
            Step::Announce => {
                let shown: Vec<_> = inodes.up_to_date(&ALL).map(|(n, _, value)| (n, value.clone())).collect();
                for (number, value) in shown {
                    let file = self.known[&number].file;
                    if value != self.value(file) {
                        inodes.retire(number, now);
                        self.last.remove(&file);
                    }
                }
            }
            Step::Renew(picked) => {
                let Some(number) = self.pick(picked) else { return };
                let Some(node) = inodes.due(number, now) else { return };
                let known = self.known.get_mut(&number).expect("it was picked");
                assert_eq!(node, node_of(known.file));
                assert!(known.writing == 0 && known.waiting.is_empty(), "only when idle");
                let delay = if known.file == WRITABLE { 0 } else { delay() };
                assert!(self.now >= known.last_lookup + delay, "only after the delay");
                known.bytes = read_bytes(&self.files[known.file as usize]);
                inodes.renew(number, as_value(known.bytes.as_deref()), now);
            }
            Step::Tidy => self.tidy(inodes),
            Step::Wait(millis) => self.now += millis,
        }
    }

    fn tidy(&mut self, inodes: &mut Inodes<u32>) {
        drop_resting(inodes, self.now);
        let dropped: Vec<u64> =
            self.known.keys().copied().filter(|&number| inodes.get(number).is_none()).collect();
        for number in dropped {
            let known = self.known.get_mut(&number).expect("it was listed");
            assert!(known.writing == 0 && known.waiting.is_empty(), "only when idle");
            assert!(self.now >= known.last_lookup + IN_USE.as_millis() as u64, "only after a while");
            self.last.retain(|_, last| *last != number);
            if number % 2 == 0 {
                self.known.remove(&number);
                continue;
            }
            // Somebody has it open.
            known.has_rested = true;
            known.bytes = read_bytes(&self.files[known.file as usize]);
            let sharing = if known.file == WRITABLE { Sharing::Alone } else { Sharing::By(0) };
            inodes.wake(number, as_value(known.bytes.as_deref()), sharing, at(self.now));
        }
    }

    fn look_up(&mut self, file: u32, thread: u32, inodes: &mut Inodes<u32>) {
        let sharing = if file == WRITABLE { Sharing::Alone } else { Sharing::By(thread) };
        let shown = inodes.enter(node_of(file), self.value(file), sharing, at(self.now));
        let (bytes, number) = (self.bytes(file), shown.number);
        if file == WRITABLE {
            assert!(!self.known.contains_key(&number), "each lookup has a nodeid of its own");
        } else if let Some(last) = self.last.insert(file, number)
            && bytes.is_some()
            && self.known.get(&last).is_some_and(|known| known.bytes == bytes)
        {
            assert_eq!(number, last, "an unchanged value keeps its nodeid");
        }
        let known = self.known.entry(number).or_insert_with(|| Known {
            file,
            thread,
            lookups: 0,
            last_lookup: 0,
            bytes: bytes.clone(),
            writing: 0,
            waiting: Vec::new(),
            has_rested: false,
        });
        assert_eq!((known.file, &known.bytes), (file, &bytes), "a lookup finds the present value");
        assert!(bytes.is_some() || known.thread == thread, "threads do not share an unread nodeid");
        assert!(known.writing == 0, "a lookup does not find what is being written");
        known.lookups += 1;
        // The table has found it again.
        known.has_rested |= inodes.get(number).is_some_and(|inode| inode.lookups >= UNKNOWN);
        known.last_lookup = self.now;
    }

    /// One nodeid never shows two values unless it was renewed, and its size matches its bytes.
    fn check(&self, inodes: &Inodes<u32>) {
        assert_eq!(inodes.live.len(), self.known.len(), "what was not forgotten");
        for (&number, known) in &self.known {
            assert_eq!(value(inodes, number), &as_value(known.bytes.as_deref()));
            let size = known.bytes.as_ref().map_or(4096, |bytes| bytes.len() as u64);
            assert_eq!(shown(inodes, number, self.now).size, size);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 1000, failure_persistence: None, ..Default::default() })]
    #[test]
    fn random_operations_match_the_model(steps in proptest::collection::vec(step(), 1..60)) {
        let (mut inodes, mut model) = (inodes(), Model::new());
        for step in steps {
            model.apply(&step, &mut inodes);
            model.check(&inodes);
        }
    }
}
