"""Places for a few, and a line of those who wait."""

import asyncio
from contextlib import suppress

from viewer.serving.waiting import WaitingRoom


class Guest:
    """Takes a place until it is sent away."""

    def __init__(self, room, name):
        self.inside, self.told, self.gone = asyncio.Event(), [], asyncio.Event()
        self.task = asyncio.create_task(self.visit(room, name))

    async def visit(self, room, name):
        async with room.place(name, self.tell):
            self.inside.set()
            await self.gone.wait()

    async def tell(self, before):
        self.told.append(before)

    async def leave(self):
        self.gone.set()
        await self.task


def run(visit):
    asyncio.run(asyncio.wait_for(visit(), 20.0))


def test_who_comes_first_is_in_first():
    async def visit():
        room = WaitingRoom(2, rate=1000.0, burst=10)
        guests = [Guest(room, str(i)) for i in range(4)]
        await asyncio.sleep(0.05)
        assert [one.inside.is_set() for one in guests] == [True, True, False, False]
        assert [one.told for one in guests] == [[], [], [0], [1]]
        assert room.anybody_waits
        await guests[1].leave()
        await asyncio.wait_for(guests[2].inside.wait(), 1.0)
        assert not guests[3].inside.is_set()
        for one in (guests[0], guests[2]):
            await one.leave()
        await asyncio.wait_for(guests[3].inside.wait(), 1.0)
        assert not room.anybody_waits
        await guests[3].leave()

    run(visit)


def test_who_gives_up_waiting_takes_no_place():
    async def visit():
        room = WaitingRoom(1, rate=1000.0, burst=10)
        first, second, third = (Guest(room, str(i)) for i in range(3))
        await asyncio.sleep(0.05)
        second.task.cancel()
        with suppress(asyncio.CancelledError):
            await second.task
        await first.leave()
        await asyncio.wait_for(third.inside.wait(), 1.0)
        await third.leave()
        again = Guest(room, "again")
        await asyncio.wait_for(again.inside.wait(), 1.0)
        await again.leave()

    run(visit)


def test_newcomers_come_at_a_steady_rate():
    async def visit():
        room = WaitingRoom(4, rate=20.0, burst=2)
        loop = asyncio.get_running_loop()
        start = loop.time()
        for i in range(8):
            guest = Guest(room, str(i))
            await guest.inside.wait()
            await guest.leave()
        assert 0.25 < loop.time() - start < 2.0

    run(visit)


def test_an_error_inside_frees_the_place():
    async def visit():
        room = WaitingRoom(1, rate=1000.0, burst=10)

        async def tell(_):
            raise AssertionError

        with suppress(KeyError):
            async with room.place("a", tell):
                raise KeyError
        guest = Guest(room, "b")
        await asyncio.wait_for(guest.inside.wait(), 1.0)
        await guest.leave()

    run(visit)
