// Where to put the probe after the tester has clamped the board: Prober TURN_DEG [NET]
// It takes the run that finished last, reads its fiducials, and probes all test points, or those of one net. Here a
// stand-in reads them, which has turned the board by TURN_DEG about the CAD origin and shifted it: a real program moves
// the tester's camera to each fiducial. Compile it with VaoiStation.cs, as Tester.cs.
using System;
using System.Linq;
using System.Threading.Tasks;
using Vaoi;

static class Prober
{
    const double SigmaMm = 0.008, ClearanceMm = 3.0, MarginMm = 0.5; // of a reading; height and distance of the probe

    static Reading ReadFiducial(Fiducial mark, double turnDeg)
    {
        double c = Math.Cos(turnDeg * Math.PI / 180), s = Math.Sin(turnDeg * Math.PI / 180);
        return new Reading { Fiducial = mark.Name, X = 400 + c * mark.X - s * mark.Y, Y = 250 + s * mark.X + c * mark.Y };
    }

    static async Task<int> Work(double turnDeg, string net)
    {
        string address = Environment.GetEnvironmentVariable("VAOI_STATION") ?? "http://127.0.0.1:8350";
        string key = Environment.GetEnvironmentVariable("VAOI_KEY");
        using (var station = new VaoiStation(address, key, Environment.GetEnvironmentVariable("VAOI_CA")))
        {
            Run run = await station.LatestRun();
            if (run == null) { Console.Error.WriteLine("No board was filmed yet."); return 1; }
            BoardType board = await station.BoardType(run.BoardType);
            var asked = new ClampedRequest
            {
                Readings = board.Fiducials.Select(mark => ReadFiducial(mark, turnDeg)).ToArray(),
                Sigma = SigmaMm, TurnDeg = turnDeg, Clearance = ClearanceMm, Margin = MarginMm,
                TestPoints = net == null, Nets = net == null ? null : new[] { net },
            };
            Clamped found = await station.Clamped(run.Id, asked);
            foreach (Reason reason in found.Reasons)
                Console.WriteLine(reason.Code + ": " + reason.Message + " " + reason.Action);
            foreach (string remark in found.Remarks) Console.WriteLine("note: " + remark);
            if (found.Status == "failed") return 1; // nothing is probed
            foreach (ClampedPoint point in found.Points)
            {
                string place = FormattableString.Invariant($"x {point.X:0.0000} y {point.Y:0.0000} z {point.Z:0.000} mm");
                bool known = Math.Max(point.SigmaX, point.SigmaY) <= 0.05;
                Console.WriteLine(point.Name + " (" + point.Net + "): " + (known ? place : "not probed, its place is not known"));
            }
            foreach (KeepOut solid in found.KeepOuts)
                Console.WriteLine("keep out " + solid.Component + (solid.Top == null ? ", height unknown" : ""));
            return 0;
        }
    }

    static int Main(string[] arguments)
    {
        try
        {
            double turn = double.Parse(arguments[0], System.Globalization.CultureInfo.InvariantCulture);
            return Work(turn, arguments.Length > 1 ? arguments[1] : null).GetAwaiter().GetResult();
        }
        catch (StationException refused)
        {
            Console.Error.WriteLine(refused.Code + ": " + refused.Message + " " + refused.Action);
            return 1;
        }
    }
}
