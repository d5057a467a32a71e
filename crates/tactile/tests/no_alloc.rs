//! The reader allocates nothing: not for a frame, a tare, a fault or a reading.
#![expect(unsafe_code, reason = "a counting allocator is a global allocator")]

use moca_tactile::{BoardEvent, Chunk, CloseReason, Cover, CoverConfig};
use std::alloc::{GlobalAlloc, Layout, System};
use std::cell::Cell;

thread_local! {
    static ALLOCATIONS: Cell<usize> = const { Cell::new(0) };
}

struct Counting;

// SAFETY: every call goes to the system's allocator unchanged.
unsafe impl GlobalAlloc for Counting {
    unsafe fn alloc(&self, layout: Layout) -> *mut u8 {
        ALLOCATIONS.with(|count| count.set(count.get() + 1));
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.alloc(layout) }
    }

    unsafe fn dealloc(&self, pointer: *mut u8, layout: Layout) {
        // SAFETY: the caller's contract is the system allocator's.
        unsafe { System.dealloc(pointer, layout) }
    }
}

#[global_allocator]
static ALLOCATOR: Counting = Counting;

#[test]
fn no_allocation_on_good_frames_tare_faults_and_readings() {
    let folder = std::path::Path::new(env!("CARGO_MANIFEST_DIR")).join("../../tests/fixtures/recordings");
    let streams: Vec<Vec<u8>> = ["", "-host-stall", "-i2c-lost", "-chip-reset"]
        .iter()
        .map(|name| std::fs::read(folder.join(format!("datastream-2020{name}.txt"))).unwrap())
        .collect();
    let mut cover = Cover::<11>::new(CoverConfig::default()).unwrap();
    let (mut now_ns, mut good, mut faults) = (0, 0, 0);
    let before = ALLOCATIONS.with(Cell::get);
    for stream in &streams {
        cover.event(0, &BoardEvent::Opened { at_ns: now_ns });
        cover.start_tare(now_ns);
        for piece in stream.chunks(17) {
            now_ns += 1_000_000;
            cover.event(0, &BoardEvent::Bytes(Chunk::new(now_ns, piece)));
            faults += usize::from(cover.poll(now_ns).fault.is_some());
        }
        good += cover.boards().map(|board| board.stats().frames_good).sum::<u64>();
        cover.event(0, &BoardEvent::Closed { at_ns: now_ns, why: CloseReason::Disconnected });
    }
    let allocations = ALLOCATIONS.with(Cell::get) - before;
    assert!(good > 800 && faults > 1000, "{good} {faults}");
    assert_eq!(allocations, 0);
}
