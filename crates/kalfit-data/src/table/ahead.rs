//! Reading ahead: blocks of rows, or what else a file is cut into, are decoded by many threads while others are taken in, and taken in by one thread, in order.

use crate::block::Block;
use crate::error::DataError;

/// Makes a block: what can be done apart from everything else.
pub(crate) type Make<'a, T> = Box<dyn FnOnce() -> T + Send + 'a>;

/// A block to be made.
pub(crate) struct Task<'a, T = Block> {
    /// Makes it.
    pub(crate) make: Make<'a, T>,
    /// How far the table is with it.
    pub(crate) done: Done,
}

/// How much of a table is read.
#[derive(Debug, Clone, Copy)]
pub(crate) enum Done {
    Bytes(u64),
    /// Of its rows; 0 when their number is not known.
    Share(f64),
}

/// What a table is cut into.
pub(crate) trait Tasks<'a, T = Block> {
    /// The next block to be made; `None` at the end. An error stands after the blocks before it.
    fn next(&mut self) -> Result<Option<Task<'a, T>>, DataError>;

    /// So many blocks are made one by one, so that the first tests are there soon and small tables take one thread.
    fn alone(&self) -> usize;
}

/// Whether more is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Goes {
    On,
    NoFurther,
}

/// Blocks that are made and not yet taken.
type Made<T> = Vec<(T, Done)>;

/// Hands all blocks to `take`, in their order, as long as it wants them: the first error is the same for any number of threads.
pub(crate) fn each<'a, T: Default + Send, E: From<DataError>>(
    table: &mut dyn Tasks<'a, T>,
    take: &mut dyn FnMut(T, Done) -> Result<Goes, E>,
) -> Result<Goes, E> {
    let mut alone = table.alone();
    let threads = rayon::current_num_threads();
    while alone > 0 || threads == 1 {
        let Some(Task { make, done }) = table.next()? else { return Ok(Goes::On) };
        if take(make(), done)? == Goes::NoFurther {
            return Ok(Goes::NoFurther);
        }
        alone = alone.saturating_sub(1);
    }
    together(table, threads, take)
}

/// While the blocks of one round are made, those of the round before are taken and what the next round needs is read.
fn together<'a, T: Default + Send, E: From<DataError>>(
    table: &mut dyn Tasks<'a, T>,
    width: usize,
    take: &mut dyn FnMut(T, Done) -> Result<Goes, E>,
) -> Result<Goes, E> {
    let mut made = Made::<T>::new();
    let mut round = Round::read(table, width);
    loop {
        let Round { tasks, end } = round;
        let mut places: Made<T> = tasks.iter().map(|task| (T::default(), task.done)).collect();
        let (goes, next) = rayon::in_place_scope(|scope| {
            for (task, place) in tasks.into_iter().zip(&mut places) {
                scope.spawn(move |_| place.0 = (task.make)());
            }
            let goes = take_all(std::mem::take(&mut made), take);
            let wanted = end.is_none() && matches!(goes, Ok(Goes::On));
            (goes, wanted.then(|| Round::read(table, width)))
        });
        if goes? == Goes::NoFurther {
            return Ok(Goes::NoFurther);
        }
        made = places;
        match (next, end) {
            (Some(next), _) => round = next,
            (None, end) => {
                let goes = take_all(made, take)?;
                return if goes == Goes::On { end.unwrap_or(Ok(())).map(|()| goes).map_err(E::from) } else { Ok(goes) };
            }
        }
    }
}

fn take_all<T, E>(made: Made<T>, take: &mut dyn FnMut(T, Done) -> Result<Goes, E>) -> Result<Goes, E> {
    for (block, done) in made {
        if take(block, done)? == Goes::NoFurther {
            return Ok(Goes::NoFurther);
        }
    }
    Ok(Goes::On)
}

/// Blocks to be made at the same time.
struct Round<'a, T> {
    tasks: Vec<Task<'a, T>>,
    /// What stands after them, when nothing more is to be made.
    end: Option<Result<(), DataError>>,
}

impl<'a, T> Round<'a, T> {
    fn read(table: &mut dyn Tasks<'a, T>, width: usize) -> Round<'a, T> {
        let mut tasks = Vec::with_capacity(width);
        while tasks.len() < width {
            match table.next() {
                Ok(Some(task)) => tasks.push(task),
                Ok(None) => return Round { tasks, end: Some(Ok(())) },
                Err(error) => return Round { tasks, end: Some(Err(error)) },
            }
        }
        Round { tasks, end: None }
    }
}
