"""The loaders as a LightningDataModule, which goes on in the middle of an epoch after a restart.

Importing this module needs Lightning, ``pip install 'eldata[lightning]'``; nothing else of eldata does.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Unpack

from eldata.base.numbers import checked_whole
from eldata.datasets.loading import LoaderOptions, evaluation_loader, set_epoch, training_loader
from eldata.errors import ArgumentError, EldataError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from torch.utils.data import DataLoader, Dataset

__all__ = ["EldataModule", "MissingLightningError", "TrainingBatches"]


class MissingLightningError(EldataError, ImportError):
    """The package lightning is not installed."""


try:
    from lightning.pytorch import LightningDataModule
except ImportError as error:
    raise MissingLightningError(
        "eldata's data module needs the package lightning: pip install 'eldata[lightning]'; "
        "eldata.datasets.training_loader and evaluation_loader work without it"
    ) from error


class TrainingBatches:
    """A training loader, epoch after epoch, whose place in an epoch can be kept in a checkpoint.

    Each iteration is the next epoch: its order, its items' crops and noise. Lightning keeps :meth:`state_dict` in its
    checkpoints, and so may any loop of your own: the interface is that of torchdata's ``StatefulDataLoader``.

    Parameters
    ----------
    loader
        From :func:`eldata.datasets.training_loader`.
    epoch
        The first one.
    """

    def __init__(self, loader: DataLoader[Any], epoch: int = 0) -> None:
        self.loader = loader
        self._next = (epoch, 0)
        self._at = (epoch, 0)

    def __len__(self) -> int:
        return len(self.loader)

    def __iter__(self) -> Iterator[Any]:
        epoch, first = self._at = self._next
        self._next = (epoch + 1, 0)
        set_epoch(self.loader, epoch, first_batch=first)
        for given, batch in enumerate(self.loader, start=first + 1):
            if given > len(self):  # the sampler's length is that of a whole epoch
                break
            self._at = (epoch, given)
            yield batch

    def state_dict(self) -> dict[str, int]:
        """Return the epoch, and how many of its batches were given out."""
        epoch, given = self._at
        return {"epoch": epoch, "batches": given}

    def load_state_dict(self, state: Mapping[str, int]) -> None:
        """Go on after the batches that were given out; the next iteration gives the rest of that epoch.

        Raises
        ------
        ArgumentError
            If the state is not one of :meth:`state_dict`, or is of more batches than an epoch has: of another data set
            or batch size.
        """
        if set(state) != {"epoch", "batches"}:
            raise ArgumentError(f"expected a state with epoch and batches, found {', '.join(sorted(state)) or 'none'}")
        epoch, given = checked_whole("epoch", state["epoch"]), checked_whole("batches", state["batches"])
        if given > len(self):
            raise ArgumentError(
                f"the checkpoint has given out {given} batches of an epoch, and here one has {len(self)}; take the "
                "data and batch size of then"
            )
        self._at = (epoch, given)
        self._next = (epoch + 1, 0) if given == len(self) else (epoch, given)


class _EvaluationBatches:
    """An evaluation loader that Lightning leaves as it is: of a DataLoader it would replace the sampler over ranks."""

    def __init__(self, loader: DataLoader[Any]) -> None:
        self.loader = loader

    def __len__(self) -> int:
        return len(self.loader)

    def __iter__(self) -> Iterator[Any]:
        return iter(self.loader)


class EldataModule(LightningDataModule):
    """The data of a ``lightning.Trainer``: :func:`~eldata.datasets.training_loader`, ``evaluation_loader``.

    Every rank gets as many training batches and none twice, each evaluation item comes exactly once over all ranks, and
    a run that goes on from a checkpoint, in the middle of an epoch too, gets the very batches that it would have had.
    Lightning's own sampler is not used, whatever ``use_distributed_sampler`` says.

    Parameters
    ----------
    training
        A dataset for ``fit``, such as :class:`eldata.PackedStore`.
    validation
        A dataset, or several, for ``fit``, ``validate`` and ``test``.
    batch_size
        Of training; in evaluation items come one by one, since frames may differ in size.
    options
        Of both loaders: :class:`~eldata.datasets.loading.LoaderOptions`.

    Raises
    ------
    ArgumentError
        As the loaders do, once Lightning asks for them.
    """

    def __init__(
        self,
        training: Dataset[Any] | None = None,
        validation: Dataset[Any] | Sequence[Dataset[Any]] = (),
        *,
        batch_size: int = 1,
        **options: Unpack[LoaderOptions],
    ) -> None:
        super().__init__()
        self.training = training
        several: Any = validation if isinstance(validation, (list, tuple)) else [validation]
        self.validation: list[Dataset[Any]] = list(several)
        self.batch_size = batch_size
        self.options = options

    def train_dataloader(self) -> TrainingBatches | list[Any]:
        """Return the training batches, from the trainer's epoch on."""
        if self.training is None:
            return []
        epoch = 0 if self.trainer is None else self.trainer.current_epoch
        return TrainingBatches(training_loader(self.training, self.batch_size, **self.options), epoch)

    def val_dataloader(self) -> list[_EvaluationBatches]:
        """Return the batches of each validation set."""
        return [_EvaluationBatches(evaluation_loader(one, **self.options)) for one in self.validation]

    def test_dataloader(self) -> list[_EvaluationBatches]:
        """Return what :meth:`val_dataloader` does."""
        return self.val_dataloader()
