//! Reading ahead: blocks of rows, or what else a file is cut into, are decoded by many threads while others are taken in, and taken in by one thread, in order.

use crate::block::RowBlock;
use crate::error::DataError;

/// Makes a block: what can be done apart from everything else.
pub(crate) type MakeBlock<'a, T> = Box<dyn FnOnce() -> T + Send + 'a>;

/// A block to be made.
pub(crate) struct BlockTask<'a, T = RowBlock> {
    /// Makes it.
    pub(crate) make: MakeBlock<'a, T>,
    /// How far the table is with it.
    pub(crate) done: TableProgress,
}

/// How much of a table is read.
#[derive(Debug, Clone, Copy)]
pub(crate) enum TableProgress {
    Bytes(u64),
    /// Of its rows; 0 when their number is not known.
    Share(f64),
}

/// What a table is cut into.
pub(crate) trait BlockTasks<'a, T = RowBlock> {
    /// The next block to be made; `None` at the end. An error stands after the blocks before it.
    fn next(&mut self) -> Result<Option<BlockTask<'a, T>>, DataError>;

    /// So many blocks are made one by one, so that the first tests are there soon and small tables take one thread.
    fn alone(&self) -> usize;
}

/// Whether more is wanted.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
pub(crate) enum Demand {
    More,
    NoMore,
}

/// Blocks that are made and not yet taken.
type MadeBlocks<T> = Vec<(T, TableProgress)>;

/// Hands all blocks to `take`, in their order, as long as it wants them: the first error is the same for any number of threads.
pub(crate) fn each<'a, T: Default + Send, E: From<DataError>>(
    table: &mut dyn BlockTasks<'a, T>,
    take: &mut dyn FnMut(T, TableProgress) -> Result<Demand, E>,
) -> Result<Demand, E> {
    let mut alone = table.alone();
    let threads = rayon::current_num_threads();
    while alone > 0 || threads == 1 {
        let Some(BlockTask { make, done }) = table.next()? else { return Ok(Demand::More) };
        if take(make(), done)? == Demand::NoMore {
            return Ok(Demand::NoMore);
        }
        alone = alone.saturating_sub(1);
    }
    together(table, threads, take)
}

/// While the blocks of one round are made, those of the round before are taken and what the next round needs is read.
fn together<'a, T: Default + Send, E: From<DataError>>(
    table: &mut dyn BlockTasks<'a, T>,
    width: usize,
    take: &mut dyn FnMut(T, TableProgress) -> Result<Demand, E>,
) -> Result<Demand, E> {
    let mut made = MadeBlocks::<T>::new();
    let mut round = BlockRound::read(table, width);
    loop {
        let BlockRound { tasks, end } = round;
        let mut places: MadeBlocks<T> = tasks.iter().map(|task| (T::default(), task.done)).collect();
        let (demand, next) = rayon::in_place_scope(|scope| {
            for (task, place) in tasks.into_iter().zip(&mut places) {
                scope.spawn(move |_| place.0 = (task.make)());
            }
            let demand = take_all(std::mem::take(&mut made), take);
            let wanted = end.is_none() && matches!(demand, Ok(Demand::More));
            (demand, wanted.then(|| BlockRound::read(table, width)))
        });
        if demand? == Demand::NoMore {
            return Ok(Demand::NoMore);
        }
        made = places;
        match (next, end) {
            (Some(next), _) => round = next,
            (None, end) => {
                let demand = take_all(made, take)?;
                return if demand == Demand::More {
                    end.unwrap_or(Ok(())).map(|()| demand).map_err(E::from)
                } else {
                    Ok(demand)
                };
            }
        }
    }
}

fn take_all<T, E>(
    made: MadeBlocks<T>,
    take: &mut dyn FnMut(T, TableProgress) -> Result<Demand, E>,
) -> Result<Demand, E> {
    for (block, done) in made {
        if take(block, done)? == Demand::NoMore {
            return Ok(Demand::NoMore);
        }
    }
    Ok(Demand::More)
}

/// Blocks to be made at the same time.
struct BlockRound<'a, T> {
    tasks: Vec<BlockTask<'a, T>>,
    /// What stands after them, when nothing more is to be made.
    end: Option<Result<(), DataError>>,
}

impl<'a, T> BlockRound<'a, T> {
    fn read(table: &mut dyn BlockTasks<'a, T>, width: usize) -> BlockRound<'a, T> {
        let mut tasks = Vec::with_capacity(width);
        while tasks.len() < width {
            match table.next() {
                Ok(Some(task)) => tasks.push(task),
                Ok(None) => return BlockRound { tasks, end: Some(Ok(())) },
                Err(error) => return BlockRound { tasks, end: Some(Err(error)) },
            }
        }
        BlockRound { tasks, end: None }
    }
}
